"""Export formats by name; an export is written completely or not at all."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import InputError, RecordingError, unknown_name
from rig.config.extras import require_extra
from rig.export.csv_parquet import export_csv, export_parquet
from rig.export.labels import export_coco, export_labelme
from rig.export.lerobot import export_lerobot
from rig.export.result import Exported, Exporter, ExportRequest, export_request


def _needs(package: str, extra: str, to: str) -> Exporter:
    """Return the exporter `export_TO` of `rig.export.TO`, imported when it is first used.

    It raises `InputError` if the extra's package is not installed.
    """

    def export(request: ExportRequest) -> Exported:
        require_extra(package, extra, f"--to {to} needs")
        return getattr(import_module(f"rig.export.{to}"), f"export_{to}")(request)

    return export


FORMATS: dict[str, Exporter] = {
    "csv": export_csv,
    "parquet": export_parquet,
    "coco": export_coco,
    "labelme": export_labelme,
    "lerobot": export_lerobot,
    "rosbag2": _needs("rosbags", "ros2", "rosbag2"),
    "rerun": _needs("rerun", "live", "rerun"),
    "zarr": _needs("zarr", "zarr", "zarr"),
    "mlflow": _needs("mlflow", "mlflow", "mlflow"),
}


def export_session(session: Path, to: str, out: Path, every: int = 10, uri: str | None = None) -> Exported:
    """Export a session into the new folder `out`; the session stays as it is.

    to: one of `FORMATS`. every, uri: see `ExportRequest`. Raises `InputError` when the folder is taken or
    the session has nothing of the kind, `SessionError` when it is damaged, `RecordingError` when
    nothing can be written. Nothing is left in `out` then.
    """
    if to not in FORMATS:
        raise unknown_name("format", to, FORMATS)
    if not session.is_dir():
        raise InputError(f"{session}: no such session folder")
    if out.exists():
        raise InputError(f"{out} exists already: remove it, or give another --out")
    request = export_request(session, out, every)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as aside:
            # a folder in it, with the permissions that a folder has here
            whole = Path(aside) / out.name
            whole.mkdir()
            exported = FORMATS[to](replace(request, out=whole, uri=uri))
            whole.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{out}: cannot be written ({error.strerror or error}); give another --out"
        ) from error
    return replace(exported, left_out=request.left_out)
