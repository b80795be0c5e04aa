"""A calibration target mounted on the simulated bench, and where it truly is; nobody else knows."""

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
"""The camera beside the gripper's palm, looking the way the fingers point."""


@dataclass(frozen=True, slots=True)
class Fixture:
    """A flat target. spec: what is printed on it. mount: "tool" or "bench".

    On the tool it is shown to the camera, which stands still. On the bench it lies on the table, and the
    camera is on the tool.
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
        """(3,) the sheet's middle in target coordinates."""
        return np.append(self.origin_m + np.array(self.grey.shape[::-1]) / self.px_per_m / 2.0, 0.0)


PrintedSheet = Callable[[str], Sheet]
"""Prints the sheet of a target's text. Raises `InputError` for a text that is not understood."""


def nothing_printed(spec: str) -> Sheet:
    """The printer of a bench that has none. Raises `InputError`."""
    raise InputError(f"target {spec}: this simulated camera was made without printed targets")


def parse_fixture(text: str) -> Fixture | None:
    """A fixture of a text like "charuco:8x6:25:18:DICT_5X5_100@tool"; None where there is no mount."""
    spec, at, mount = text.rpartition("@")
    return Fixture(spec, mount) if at and mount in _MOUNTS else None


def camera_T_target(  # noqa: N802 - frame names keep their case
    fixture: Fixture, sheet: Sheet, base_T_camera: Pose, base_T_table: Pose, base_T_tcp: Pose, seed: int,  # noqa: N803
) -> Pose:  # fmt: skip
    """Where the camera sees the target. base_T_camera: where the standing camera is."""
    rng = np.random.default_rng((seed, 31))
    if fixture.mount == "tool":
        return base_T_camera.inverse() @ base_T_tcp @ _held(base_T_camera, sheet, rng)
    return (base_T_tcp @ _tcp_T_camera(rng)).inverse() @ _lying(base_T_table, sheet, rng)


def _held(base_T_camera: Pose, sheet: Sheet, rng: np.random.Generator) -> Pose:  # noqa: N803
    """`tcp_T_target` on a tool that points down: a few cm off, facing the camera, not exactly."""
    turn = _TOOL_DOWN.inv() * base_T_camera.rotation * Rotation.from_rotvec(rng.normal(0, 0.1, 3))
    return Pose.from_rotation(rng.normal((0.0, 0.0, -0.03), 0.005) - turn.apply(sheet.middle_m), turn)


def _tcp_T_camera(rng: np.random.Generator) -> Pose:  # noqa: N802
    """The camera on the tool, a degree or two from straight."""
    return Pose.from_rotation(
        rng.normal(_CAMERA_ON_TOOL_M, 0.003), Rotation.from_rotvec(rng.normal(0, 0.03, 3))
    )


def _lying(base_T_table: Pose, sheet: Sheet, rng: np.random.Generator) -> Pose:  # noqa: N803
    """`base_T_target` face up on the table, turned a little."""
    turn = Rotation.from_euler("z", rng.normal(0, 0.2)) * _TOOL_DOWN
    place = np.add(base_T_table.position_m, rng.normal((0.0, 0.0, -0.04), 0.004))
    return Pose.from_rotation(place - turn.apply(sheet.middle_m), turn)


_TIP_M = (0.0021, -0.0014, 0.0320)
_TIP_SPREAD_M = 0.002
_HOLE_FROM_TABLE_M = (0.02, 0.03, 0.0)


def tip_m(seed: int) -> Vector3:
    """Where the tip is in the TCP's frame: clamped by hand, so different for each seed."""
    x, y, z = (float(v) for v in np.random.default_rng((seed, 41)).normal(_TIP_M, _TIP_SPREAD_M))
    return x, y, z


def gap_m(base_T_tcp: Pose, base_T_table: Pose, seed: int) -> Vector3:  # noqa: N803
    """From the tip to the bottom of the hole, along the base's axes: what a person beside it sees."""
    tip = base_T_tcp.rotation.apply(tip_m(seed)) + np.asarray(base_T_tcp.position_m)
    x, y, z = (float(v) for v in np.add(base_T_table.position_m, _HOLE_FROM_TABLE_M) - tip)
    return x, y, z
