"""The calibration target mounted on the simulated bench, and its true pose, known only to the simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Image, Pose, Vector3

_MOUNTS = ("tool", "bench")
_TOOL_DOWN = Rotation.from_euler("x", 180, degrees=True)
_CAMERA_ON_TOOL_M = (0.012, -0.065, -0.110)
"""Position of a camera on the tool, beside the gripper's palm; it looks in the direction of the fingers."""


@dataclass(frozen=True, slots=True)
class Fixture:
    """A mounted flat target.

    spec: name of the printed target. mount: "tool" if the target is on the tool and the camera is fixed;
    "bench" if the target lies on the table and the camera is on the tool.
    """

    spec: str
    mount: str


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A printed target on white paper.

    grey: (H, W) uint8. origin_m: (2,) target coordinates of the top left corner. px_per_m: density.
    """

    grey: Image
    origin_m: NDArray[np.floating]
    px_per_m: float

    @property
    def middle_m(self) -> NDArray[np.floating]:
        """Centre of the sheet in target coordinates, (3,)."""
        return np.append(self.origin_m + np.array(self.grey.shape[::-1]) / self.px_per_m / 2.0, 0.0)


PrintedSheet = Callable[[str], Sheet]
"""Function that prints the sheet of a target by its name. Raises `InputError` for an unknown name."""


def nothing_printed(spec: str) -> Sheet:
    """Raise `InputError`: the `PrintedSheet` of a bench without printed targets."""
    raise InputError(f"target {spec}: this simulated camera was made without printed targets")


def parse_fixture(text: str) -> Fixture | None:
    """Return the fixture for a text like "charuco:8x6:25:18:DICT_5X5_100@tool"; None if it has no mount."""
    spec, at, mount = text.rpartition("@")
    return Fixture(spec, mount) if at and mount in _MOUNTS else None


def camera_T_target(  # noqa: N802 - frame names keep their case
    fixture: Fixture, sheet: Sheet, base_T_camera: Pose, base_T_table: Pose, base_T_tcp: Pose, seed: int,  # noqa: N803
) -> Pose:  # fmt: skip
    """Return the true camera_T_target. base_T_camera: pose of the fixed camera."""
    rng = np.random.default_rng((seed, 31))
    if fixture.mount == "tool":  # the tool points down, a few cm from the TCP, roughly facing the camera
        turn = _TOOL_DOWN.inv() * base_T_camera.rotation * Rotation.from_rotvec(rng.normal(0, 0.1, 3))
        place = rng.normal((0.0, 0.0, -0.03), 0.005) - turn.apply(sheet.middle_m)
        return base_T_camera.inverse() @ base_T_tcp @ Pose.from_rotation(place, turn)
    place, tilt = rng.normal(_CAMERA_ON_TOOL_M, 0.003), Rotation.from_rotvec(rng.normal(0, 0.03, 3))
    base_T_camera = base_T_tcp @ Pose.from_rotation(place, tilt)  # noqa: N806
    turn = Rotation.from_euler("z", rng.normal(0, 0.2)) * _TOOL_DOWN  # face up on the table, turned slightly
    place = np.add(base_T_table.position_m, rng.normal((0.0, 0.0, -0.04), 0.004))
    return base_T_camera.inverse() @ Pose.from_rotation(place - turn.apply(sheet.middle_m), turn)


_TIP_M = (0.0021, -0.0014, 0.0320)
_TIP_SPREAD_M = 0.002
HOLE_FROM_TABLE_M = (0.02, 0.03, 0.0)
"""Position of the bottom of the hole, from the table's."""


def tip_m(seed: int) -> Vector3:
    """Return the position of the tip in the TCP frame, m; it depends on the seed, as when clamped by hand."""
    x, y, z = (float(v) for v in np.random.default_rng((seed, 41)).normal(_TIP_M, _TIP_SPREAD_M))
    return x, y, z
