"""Export sessions by the name of a format; an export is written completely or not at all."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import InputError, RecordingError, no_such, unknown_name
from rig.config.extras import require_extra
from rig.export.csv_parquet import export_csv, export_parquet
from rig.export.labels import export_coco, export_labelme
from rig.export.lerobot import export_lerobot
from rig.export.result import Exported, Exporter, ExportRequest, export_request


def _export_rosbag2(request: ExportRequest) -> Exported:
    """Write ROS 2 bags. Raises `InputError` if rosbags is not installed."""
    require_extra("rosbags", "ros2", "--to rosbag2 needs")
    from rig.export.rosbag2 import export_rosbag2

    return export_rosbag2(request)


FORMATS: dict[str, Exporter] = {
    "csv": export_csv,
    "parquet": export_parquet,
    "coco": export_coco,
    "labelme": export_labelme,
    "lerobot": export_lerobot,
    "rosbag2": _export_rosbag2,
}


def export_session(session: Path, to: str, out: Path, every: int = 10) -> Exported:
    """Export a session to the new folder `out`, without changing the session.

    to: one of `FORMATS`. every: see `ExportRequest`. Raises `InputError` if the folder exists or the
    format does not fit the session, `SessionError` if the session is damaged, and `RecordingError` if the
    folder cannot be written. After an error `out` does not exist.
    """
    if to not in FORMATS:
        raise unknown_name("format", to, FORMATS)
    if not session.is_dir():
        raise InputError(no_such(session, "session folder"))
    if out.exists():
        raise InputError(f"{out} exists already: remove it, or give another --out")
    request = export_request(session, out, every)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as aside:
            # a folder inside, because the temporary folder itself has restricted permissions
            whole = Path(aside) / out.name
            whole.mkdir()
            exported = FORMATS[to](replace(request, out=whole))
            whole.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{out}: cannot be written ({error.strerror or error}); give another --out"
        ) from error
    return replace(exported, left_out=request.left_out)
