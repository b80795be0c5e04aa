"""What every gripper must do."""

import pytest

from drivers.bench import Bench
from drivers.errors import GripperFaultError, NotConnectedError, OutOfLimitsError

ABOUT = ("gripper",)


@pytest.mark.moves
def test_fingers_need_time_and_end_where_they_were_sent(bench: Bench) -> None:
    motion = bench.gripper.move_to(100)
    assert bench.gripper.state().moving
    motion.wait(10.0)
    state = bench.gripper.state()
    assert not state.moving
    assert state.position_counts == 100


@pytest.mark.moves
def test_stop_holds_the_fingers(bench: Bench) -> None:
    bench.gripper.move_to(250)
    bench.clock.sleep_until(bench.clock.now_ns() + 300_000_000)
    bench.gripper.stop()
    held = bench.gripper.state().position_counts
    bench.clock.sleep_until(bench.clock.now_ns() + 1_000_000_000)
    assert 6 < held < 250
    assert abs(bench.gripper.state().position_counts - held) <= 1


@pytest.mark.moves
def test_positions_outside_the_limits_are_refused(bench: Bench) -> None:
    for position in (-1, bench.gripper.limits.max_counts + 1):
        with pytest.raises(OutOfLimitsError, match="counts"):
            bench.gripper.move_to(position)


def test_nothing_moves_before_activation_and_connecting_does_not_activate(inactive_bench: Bench) -> None:
    gripper = inactive_bench.gripper
    assert not gripper.state().activated
    before = gripper.state().position_counts
    with pytest.raises(GripperFaultError, match="not activated"):
        gripper.move_to(100)
    assert gripper.state().position_counts == before


def test_a_gripper_that_is_not_connected_says_so(bench: Bench) -> None:
    bench.gripper.disconnect()
    bench.gripper.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.state()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.gripper.move_to(100)
