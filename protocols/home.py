"""Move to the home pose, where the arm waits while objects are placed. Part of every plan."""

from drivers.bench import Bench
from drivers.errors import OutOfLimitsError
from drivers.motion import check_way
from drivers.types import Pose
from protocols.steps import CLEARANCE_M, MOTION_TIMEOUT_S, TRAVEL_SPEED_M_S, move

_THERE_M, _THERE_RAD = 1e-3, 5e-3
"""Largest distances from a pose at which the arm counts as being there."""


def home_plan(base_T_home: Pose, when: str) -> str:  # noqa: N803
    """Describe the motion home, for the plan that a person agrees to. when: such as "Before each lift"."""
    x, y, z = base_T_home.position_m
    return (
        f"{when} the arm goes home at up to {TRAVEL_SPEED_M_S} m/s: straight up, across, then down to "
        f"({x:.3f}, {y:.3f}, {z:.3f}) m."
    )


def go_home(bench: Bench) -> None:
    """Move a free hand home from any pose: straight up, across, down. If the arm is at home, nothing moves.

    The arm moves across at the height of home, or at its own height if that is higher, and never lower than
    `CLEARANCE_M` above the table. Raises `OutOfLimitsError` before anything moves if the path leaves the
    workspace.
    """
    here, home = bench.arm.state().base_T_tcp, bench.base_T_home
    if _is_there(here, home):
        return
    top = max(pose.position_m[2] for pose in (here, home, bench.base_T_table.translated(z_m=CLEARANCE_M)))
    way = (*(pose.translated(z_m=top - pose.position_m[2]) for pose in (here, home)), home)
    limits = bench.arm.limits
    for pose in way:
        if not limits.has_inside(pose.position_m):
            low, high = limits.workspace_min_m, limits.workspace_max_m
            raise OutOfLimitsError(
                f"arm: the path home leads through {pose.position_m} m, outside {low} to {high} m; "
                "bring the arm inside with the pendant, then start again"
            )
    check_way(limits, (here, *way))
    for pose in way:
        if not _is_there(here, pose):
            move(bench, pose, TRAVEL_SPEED_M_S).wait(MOTION_TIMEOUT_S)
            here = pose


def _is_there(here: Pose, there: Pose) -> bool:
    off_m, off_rad = here.apart(there)
    return off_m < _THERE_M and off_rad < _THERE_RAD
