"""The contract of every gripper; targets and tolerances come from its own specification."""

import pytest

from drivers.bench import Bench
from drivers.clock import to_ns, wait_until
from drivers.errors import GripperFaultError, NotConnectedError, OutOfLimitsError
from drivers.types import GripperSpec

ABOUT = ("gripper",)
MOTION_S = 15.0
"""Longest time for a part of the range."""
CLOSED_SHARE = 0.4
"""Target of the motions, as a fraction of the stroke."""
BEGUN_SHARE = 0.05
"""Fraction of the stroke after which a motion has certainly begun."""
TOLERANCE_SHARE = 0.01
"""Tolerance of a reached opening, as a fraction of the stroke; at least one step."""


def part_closed_m(spec: GripperSpec) -> float:
    """Return an opening in the open half of the range."""
    return spec.opening_at(round(CLOSED_SHARE * spec.steps))


def tolerance_m(spec: GripperSpec) -> float:
    return max(1.01 * spec.resolution_m, TOLERANCE_SHARE * spec.stroke_m)


@pytest.mark.moves
def test_motion_takes_time_and_ends_at_its_target(bench: Bench) -> None:
    spec = bench.gripper.spec
    motion = bench.gripper.move_to(part_closed_m(spec))
    assert bench.gripper.state().moving
    motion.wait(MOTION_S)
    state = bench.gripper.state()
    assert not state.moving
    assert abs(state.opening_m - part_closed_m(spec)) <= tolerance_m(spec)


@pytest.mark.moves
def test_fingers_move_by_one_step_of_the_resolution(bench: Bench) -> None:
    spec = bench.gripper.spec
    bench.gripper.move_to(part_closed_m(spec)).wait(MOTION_S)
    before_m = bench.gripper.state().opening_m
    bench.gripper.move_to(spec.closer(before_m)).wait(MOTION_S)
    closed_m = before_m - bench.gripper.state().opening_m
    assert 0.5 * spec.resolution_m < closed_m < 1.5 * spec.resolution_m


@pytest.mark.moves
def test_stop_holds_the_fingers(bench: Bench) -> None:
    spec = bench.gripper.spec
    begun_m = bench.gripper.state().opening_m - BEGUN_SHARE * spec.stroke_m
    bench.gripper.move_to(spec.closed_m)
    assert wait_until(bench.clock, lambda: bench.gripper.state().opening_m < begun_m, MOTION_S, 0.005)
    bench.gripper.stop()
    held_m = bench.gripper.state().opening_m
    bench.clock.sleep_until(bench.clock.now_ns() + to_ns(1.0))
    assert begun_m > held_m > spec.closed_m + tolerance_m(spec)
    assert abs(bench.gripper.state().opening_m - held_m) <= tolerance_m(spec)


@pytest.mark.moves
def test_motions_outside_the_limits_are_refused(bench: Bench) -> None:
    spec = bench.gripper.spec
    before_m = bench.gripper.state().opening_m
    for opening_m in (spec.open_m + spec.resolution_m, spec.closed_m - spec.resolution_m, float("nan")):
        with pytest.raises(OutOfLimitsError, match="mm"):
            bench.gripper.move_to(opening_m)
    with pytest.raises(OutOfLimitsError, match="m/s"):
        bench.gripper.move_to(part_closed_m(spec), speed_m_s=1.01 * spec.speed_m_s[1])
    with pytest.raises(OutOfLimitsError, match=" N"):
        bench.gripper.move_to(part_closed_m(spec), force_n=1.01 * spec.force_n[1])
    assert abs(bench.gripper.state().opening_m - before_m) <= tolerance_m(spec)


def test_gripper_does_not_move_before_activation(inactive_bench: Bench) -> None:
    gripper = inactive_bench.gripper
    assert not gripper.state().activated
    before_m = gripper.state().opening_m
    with pytest.raises(GripperFaultError, match="not activated"):
        gripper.move_to(part_closed_m(gripper.spec))
    assert gripper.state().opening_m == before_m


def test_state_before_connect_raises_not_connected(bench: Bench) -> None:
    bench.gripper.disconnect()
    bench.gripper.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.state()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.move_to(part_closed_m(bench.gripper.spec))
