"""The kinds of calibrations, and the difference between two files of one kind."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.camera.files import camera_from
from calibration.store import read_yaml
from drivers.errors import CalibrationError
from rig.calibrate.camera import CAMERA, MARKERS
from rig.calibrate.clocks import SYNC
from rig.calibrate.gripper import GRIPPER, TIP
from rig.calibrate.hand_eye import HAND_EYE
from rig.calibrate.kind import Kind
from rig.calibrate.tactile import TACTILE

KINDS: dict[str, Kind[Any]] = {
    kind.name: kind for kind in (CAMERA, HAND_EYE, MARKERS, TACTILE, GRIPPER, TIP, SYNC)
}


def compare_files(one: Path, other: Path) -> dict[str, float | str | None]:
    """Compare two files of one kind. Raises `CalibrationError` for different or unknown kinds."""
    kinds = [_kind_of(path) for path in (one, other)]
    if kinds[0] != kinds[1]:
        raise CalibrationError(
            f"{one} is a calibration of {kinds[0]}, {other} of {kinds[1]}: nothing to compare"
        )
    kind = KINDS.get(kinds[0])
    if kind is None or kind.compare is None:
        raise CalibrationError(f"calibrations of {kinds[0]} cannot be compared; open their pages instead")
    try:
        return {"kind": kinds[0], **kind.compare(one, other)}
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{one} or {other}: damaged ({error!r})") from error


def _kind_of(path: Path) -> str:
    """Return the kind of a calibration file, or "camera" for a camera file of another program."""
    content = read_yaml(path)
    about = content.get("calibration")
    if isinstance(about, Mapping):
        return str(about.get("kind"))
    camera_from(content, str(path))
    return "camera"
