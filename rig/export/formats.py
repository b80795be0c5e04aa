"""Export sessions by the name of a format; an export is written completely or not at all."""

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
    """Return the exporter `export_TO` of the module `rig.export.TO`, which is imported on first use.

    The exporter raises `InputError` if the package of the extra is not installed.
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
    """Export a session to the new folder `out`, without changing the session.

    to: one of `FORMATS`. every, uri: see `ExportRequest`. Raises `InputError` if the folder exists or the
    format does not fit the session, `SessionError` if the session is damaged, and `RecordingError` if the
    folder cannot be written. After an error `out` does not exist.
    """
    if to not in FORMATS:
        raise unknown_name("format", to, FORMATS)
    if not session.is_dir():
        raise InputError(f"{session}: session folder not found")
    if out.exists():
        raise InputError(f"{out} exists already: remove it, or give another --out")
    request = export_request(session, out, every)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as aside:
            # a folder inside, because the temporary folder itself has restricted permissions
            whole = Path(aside) / out.name
            whole.mkdir()
            exported = FORMATS[to](replace(request, out=whole, uri=uri))
            whole.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{out}: cannot be written ({error.strerror or error}); give another --out"
        ) from error
    return replace(exported, left_out=request.left_out)
