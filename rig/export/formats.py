"""Export formats by name; an export is written completely or not at all."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import InputError, RecordingError, unknown_name
from rig.export.csv_parquet import export_csv, export_parquet
from rig.export.labels import export_coco, export_labelme
from rig.export.lerobot import export_lerobot
from rig.export.result import Exported, Exporter, ExportRequest, export_request
from rig.frames.ros_bags import require_rosbags


def _export_rosbag2(request: ExportRequest) -> Exported:
    """Write ROS 2 bags. Raises `SessionError` for a recording, `InputError` without rosbags."""
    require_rosbags()
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
    """Export a session into the new folder `out`; the session stays as it is.

    to: one of `FORMATS`. every: see `ExportRequest`. Raises `InputError` when the folder is taken or
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
            exported = FORMATS[to](replace(request, out=whole))
            whole.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{out}: cannot be written ({error.strerror or error}); give another --out"
        ) from error
    return replace(exported, left_out=request.left_out)
