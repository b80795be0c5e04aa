"""Compute the poses of the hand for grasping an object, for lifts and poses alike, and derive seeds."""

import hashlib

from scipy.spatial.transform import Rotation

from drivers.errors import InputError, OutOfLimitsError
from drivers.types import Pose
from protocols.grasps import GraspFile, Position
from protocols.steps import require_room
from rig.bench.assembly import TOOL_DOWN
from rig.bench.twins import refuse_undrawn
from rig.config import BenchConfig


def grasp_pose(base_T_table: Pose, place: Position, turn_deg: float) -> Pose:  # noqa: N803
    """Return `base_T_tcp` at a position along the object, with the hand rotated about the closing axis.

    turn_deg: in addition to the position's own angle, counter-clockwise in the external camera's view (about
    the base's -y axis).
    """
    turned = Rotation.from_euler("y", -(place.turn_deg + turn_deg), degrees=True) * TOOL_DOWN
    return Pose.from_rotation(
        base_T_table.translated(x_m=place.offset_m, z_m=place.height_m).position_m, turned
    )


def refuse_impossible(bench: BenchConfig, grasps: GraspFile, place: Position) -> None:
    """Raise `InputError` for an object too wide for the fingers, or not drawable on a simulated bench."""
    refuse_undrawn(bench, grasps)
    try:
        require_room(bench.gripper_spec(), place.width_m)
    except OutOfLimitsError as error:
        raise InputError(f"object {grasps.id} {grasps.name}, {place.name}: {error}") from error


def derived_seed(seed: int, *what: str | int, attempt: int = 0) -> int:
    """Return a seed of 48 bits for a task, e.g. `derived_seed(0, "t1", 3)`.

    attempt: each further attempt, from 1, has a different seed.
    """
    text = "/".join(str(part) for part in (seed, *what, *([attempt] if attempt else [])))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
