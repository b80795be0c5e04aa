"""Motions: limits and keep-out boxes are checked before they are sent, and unattended ones are stopped."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, OutOfLimitsError
from drivers.motion import POLL_S, Motion, check_joints, check_motion, check_way, meets
from drivers.types import ArmLimits, Box, Pose, Vector3
from drivers.ur5e.status import JOINT_RANGE_RAD
from fakes.clock import SimulatedClock

BOX = Box("stand", (0.4, -0.1, 0.0), (0.6, 0.1, 0.2))
LARGER = Box("", (0.399, -0.101, -0.001), (0.601, 0.101, 0.201))
"""By more than the spacing of the checked points."""
LIMITS = ArmLimits((0.0, -0.5, 0.0), (0.8, 0.5, 0.6), 0.5, 1.5, 5.0, keep_out=(BOX,))
POINTS = st.tuples(*[st.floats(-0.5, 1.0, allow_nan=False).map(lambda v: round(v, 3))] * 3)
INSIDE = Pose((0.4, 0.0, 0.3))


def broken() -> bool:
    raise DeviceError("hand: broken")


def interrupted() -> bool:
    raise KeyboardInterrupt


@pytest.mark.parametrize("stop_fails", [False, True])
@pytest.mark.parametrize(
    ("later", "error", "said", "after_s"),
    [
        (lambda: False, DeviceTimeoutError, "not finished after 1.0 s; stopped it", 1.0),
        (broken, DeviceError, "hand: broken", 0.2),
        (interrupted, KeyboardInterrupt, "", 0.2),
    ],
)
def test_motion_is_stopped_at_its_time_limit_and_by_any_error_which_is_raised(
    later: Callable[[], bool], error: type[BaseException], said: str, after_s: float, stop_fails: bool
) -> None:
    """The first error is raised also if the stop fails."""
    clock, stops = SimulatedClock(), []

    def stop() -> None:
        stops.append(clock.now_ns())
        if stop_fails:
            raise DeviceError("hand: does not listen")

    motion = Motion("hand", clock, lambda: clock.now_ns() >= to_ns(0.2) and later(), stop)
    with pytest.raises(error, match=said or None):
        motion.wait(1.0)
    assert len(stops) == 1
    assert after_s <= clock.now_ns() / 1e9 <= after_s + POLL_S


@pytest.mark.parametrize(
    ("target", "speed", "acceleration", "said"),
    [
        (Pose((0.9, 0.0, 0.3)), 0.1, 0.5, "workspace"),
        (Pose((math.nan, 0.0, 0.3)), 0.1, 0.5, "workspace"),
        (Pose((0.4, 0.0, 0.3), (math.nan, 0.0, 0.0, 1.0)), 0.1, 0.5, "not a valid pose"),
        (INSIDE, 0.6, 0.5, "speed"),
        (INSIDE, 0.0, 0.5, "speed"),
        (INSIDE, math.nan, 0.5, "speed"),
        (INSIDE, 0.1, math.inf, "acceleration"),
        (INSIDE.translated(x_m=0.1, z_m=-0.2), 0.1, 0.5, "leads the hand into 'stand'"),
    ],
)
def test_motion_outside_the_limits_is_rejected(
    target: Pose, speed: float, acceleration: float, said: str
) -> None:
    check_motion(LIMITS, INSIDE, INSIDE, 0.1, 0.5)
    with pytest.raises(OutOfLimitsError, match=said):
        check_motion(LIMITS, INSIDE, target, speed, acceleration)


def test_joints_beyond_their_range_are_rejected() -> None:
    check_joints((0.1, 0.2, 0.3, 0.4, 0.5, 0.6), JOINT_RANGE_RAD, INSIDE)
    for joints, said in (
        ((0, 0, 7.0, 0, 0, 0), "joint 3"),
        ((0, 0, 0, 0, -7.0, 0), "joint 5"),
        (None, "reach"),
    ):
        with pytest.raises(OutOfLimitsError, match=said):
            check_joints(joints, JOINT_RANGE_RAD, INSIDE)


@given(POINTS, POINTS)
def test_line_intersects_a_box_if_one_of_its_points_is_inside(here: Vector3, there: Vector3) -> None:
    points = np.linspace(here, there, 2000)
    inside, near = (
        bool(np.any(np.all((points > box.min_m) & (points < box.max_m), axis=1))) for box in (BOX, LARGER)
    )
    assert inside <= meets(BOX, here, there) <= near


@pytest.mark.parametrize(
    ("way", "refused"),
    [
        (((0.2, 0.0, 0.1), (0.8, 0.0, 0.1)), True),
        (((0.2, 0.0, 0.1), (0.2, 0.0, 0.3), (0.8, 0.0, 0.3), (0.8, 0.0, 0.1)), False),
        (((0.5, 0.0, 0.3), (0.5, 0.0, 0.1)), True),
        (((0.5, 0.0, -0.1), (0.5, 0.0, 0.3)), True),
        (((0.5, 0.0, 0.1), (0.5, 0.0, 0.3)), False),
        (((0.5, 0.0, 0.1), (0.8, 0.0, 0.3)), True),
        (((0.5, 0.0, 0.1), (0.5, 0.02, 0.3)), True),
        (((0.5, 0.0, 0.2), (0.8, 0.0, 0.2)), False),
    ],
)
def test_hand_may_leave_a_box_only_straight_up(way: tuple[Vector3, ...], refused: bool) -> None:
    poses = [Pose(point) for point in way]
    if not refused:
        return check_way(LIMITS, poses)
    with pytest.raises(OutOfLimitsError, match="leads the hand into 'stand'"):
        check_way(LIMITS, poses)
