"""What every gripper must do, whatever its range: targets and tolerances come from its own limits."""

import pytest

from drivers.bench import Bench
from drivers.clock import to_ns, wait_until
from drivers.errors import GripperFaultError, NotConnectedError, OutOfLimitsError
from drivers.types import GripperLimits

ABOUT = ("gripper",)
MOTION_S = 15.0
"""Longest time for a part of the range."""
CLOSED_SHARE = 0.4
"""Where the fingers are sent, as a share of their range."""
BEGUN_SHARE = 0.05
"""Share of the range after which a motion has certainly begun."""
TOLERANCE_SHARE = 0.01
"""Of the range: how far from their target the fingers may end. At least one count."""


def part_closed(limits: GripperLimits) -> int:
    """Return a position in the open half of the range."""
    return limits.min_counts + round(CLOSED_SHARE * range_counts(limits))


def range_counts(limits: GripperLimits) -> int:
    return limits.max_counts - limits.min_counts


def tolerance_counts(limits: GripperLimits) -> int:
    return max(1, round(TOLERANCE_SHARE * range_counts(limits)))


@pytest.mark.moves
def test_fingers_need_time_and_end_where_they_were_sent(bench: Bench) -> None:
    limits = bench.gripper.limits
    motion = bench.gripper.move_to(part_closed(limits))
    assert bench.gripper.state().moving
    motion.wait(MOTION_S)
    state = bench.gripper.state()
    assert not state.moving
    assert abs(state.position_counts - part_closed(limits)) <= tolerance_counts(limits)


@pytest.mark.moves
def test_stop_holds_the_fingers(bench: Bench) -> None:
    limits = bench.gripper.limits
    begun = bench.gripper.state().position_counts + BEGUN_SHARE * range_counts(limits)
    bench.gripper.move_to(limits.max_counts)
    assert wait_until(bench.clock, lambda: bench.gripper.state().position_counts > begun, MOTION_S, 0.005)
    bench.gripper.stop()
    held = bench.gripper.state().position_counts
    bench.clock.sleep_until(bench.clock.now_ns() + to_ns(1.0))
    assert begun < held < limits.max_counts - tolerance_counts(limits)
    assert abs(bench.gripper.state().position_counts - held) <= tolerance_counts(limits)


@pytest.mark.moves
def test_positions_outside_the_limits_are_refused(bench: Bench) -> None:
    limits = bench.gripper.limits
    for position in (limits.min_counts - 1, limits.max_counts + 1):
        with pytest.raises(OutOfLimitsError, match="counts"):
            bench.gripper.move_to(position)


def test_nothing_moves_before_activation_and_connecting_does_not_activate(inactive_bench: Bench) -> None:
    gripper = inactive_bench.gripper
    assert not gripper.state().activated
    before = gripper.state().position_counts
    with pytest.raises(GripperFaultError, match="not activated"):
        gripper.move_to(part_closed(gripper.limits))
    assert gripper.state().position_counts == before


def test_a_gripper_that_is_not_connected_says_so(bench: Bench) -> None:
    bench.gripper.disconnect()
    bench.gripper.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.state()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.move_to(part_closed(bench.gripper.limits))
