"""The contract of every arm."""

import numpy as np
import pytest

from drivers.bench import Bench
from drivers.clock import wait_until
from drivers.errors import DeviceTimeoutError, NotConnectedError, OutOfLimitsError
from drivers.types import ArmMode

ABOUT = ("arm",)


@pytest.mark.moves
def test_a_motion_ends_where_it_was_sent(bench: Bench) -> None:
    target = bench.arm.state().base_T_tcp.translated(x_m=0.05, z_m=-0.1)
    motion = bench.arm.move_linear(target, 0.2, 1.0)
    assert not motion.done()
    motion.wait(10.0)
    assert motion.done()
    assert np.allclose(bench.arm.state().base_T_tcp.position_m, target.position_m, atol=2e-4)


def test_state_is_fresh_and_running(bench: Bench) -> None:
    state = bench.arm.state()
    assert state.mode is ArmMode.RUNNING
    assert 0 <= bench.clock.now_ns() - state.time_ns < 100_000_000


def test_wrench_is_measured_or_declared_missing(bench: Bench) -> None:
    """A constant wrench in place of a measured one would never stop the arm at contact."""
    wrench = bench.arm.state().wrench
    if bench.arm.limits.max_contact_force_n is None:
        assert wrench is None
    else:
        assert wrench is not None
        assert any(wrench), "exactly zero: without a force sensor return None, and write force_sensor = false"


@pytest.mark.moves
def test_stop_ends_a_motion_on_its_way(bench: Bench) -> None:
    start = bench.arm.state().base_T_tcp
    motion = bench.arm.move_linear(start.translated(z_m=-0.2), 0.1, 1.0)
    # a motion continues only while the program polls the arm
    assert wait_until(
        bench.clock,
        lambda: bench.arm.state().base_T_tcp.position_m[2] < start.position_m[2] - 0.03,
        5.0,
        0.01,
    )
    bench.arm.stop()
    there = bench.arm.state().base_T_tcp.position_m[2]
    bench.clock.sleep_until(bench.clock.now_ns() + 500_000_000)
    assert motion.done()
    assert start.position_m[2] - 0.19 < there < start.position_m[2] - 0.01
    assert bench.arm.state().base_T_tcp.position_m[2] == pytest.approx(there, abs=0.01)


@pytest.mark.moves
def test_limits_are_checked_before_anything_moves(bench: Bench) -> None:
    limits, start = bench.arm.limits, bench.arm.state().base_T_tcp
    outside = start.translated(x_m=limits.workspace_max_m[0])
    with pytest.raises(OutOfLimitsError, match="workspace"):
        bench.arm.move_linear(outside, 0.1, 0.5)
    with pytest.raises(OutOfLimitsError, match="speed"):
        bench.arm.move_linear(start, 2 * limits.max_speed_m_s, 0.5)
    with pytest.raises(OutOfLimitsError, match="acceleration"):
        bench.arm.move_linear(start, 0.1, 2 * limits.max_acceleration_m_s2)
    with pytest.raises(OutOfLimitsError, match="speed"):
        bench.arm.move_linear(start, float("nan"), 0.5)
    assert np.allclose(bench.arm.state().base_T_tcp.position_m, start.position_m, atol=2e-4)


def test_state_before_connect_raises_not_connected(bench: Bench) -> None:
    bench.arm.disconnect()
    bench.arm.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        bench.arm.state()


@pytest.mark.moves
def test_motion_beyond_its_timeout_is_stopped(bench: Bench) -> None:
    start = bench.arm.state().base_T_tcp
    motion = bench.arm.move_linear(start.translated(z_m=-0.2), 0.05, 1.0)
    with pytest.raises(DeviceTimeoutError, match="stopped it"):
        motion.wait(0.3)
    bench.clock.sleep_until(bench.clock.now_ns() + 300_000_000)
    there = bench.arm.state().base_T_tcp.position_m[2]
    bench.clock.sleep_until(bench.clock.now_ns() + 300_000_000)
    assert bench.arm.state().base_T_tcp.position_m[2] == pytest.approx(there, abs=2e-4)
    assert there > start.position_m[2] - 0.1


def test_recover_asks_nothing_while_the_arm_runs(bench: Bench) -> None:
    bench.arm.recover(lambda question: pytest.fail(question))
    assert bench.arm.state().mode is ArmMode.RUNNING
