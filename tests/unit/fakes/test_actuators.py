"""How late the simulated hand obeys: the gripper's line and finger speed, the arm's way of braking."""

import pytest

from drivers.clock import to_ns
from drivers.types import Pose
from fakes.clock import SimulatedClock
from fakes.devices.arm import STOP_DECELERATION_M_S2, FakeArm
from fakes.devices.gripper import ACCELERATION_COUNTS_S2, SPEED_COUNTS_S, FakeGripper
from fakes.faults import FaultScript
from fakes.objects.catalogue import find_object
from fakes.world.motion import ToolPath
from fakes.world.state import BenchLayout
from fakes.world.world import FINGER_STIFFNESS_N_M, World
from rig.bench.assembly import TOOL_DOWN
from support.finger_counts import OPEN_COUNTS, counts_of, opening_m

PERIOD_S = 0.01


def world() -> World:
    home = Pose.from_rotation((0.45, 0.0, 0.30), TOOL_DOWN)
    return World(BenchLayout(Pose((0.45, 0.0, 0.05)), home), seed=1)


def gripper(period_s: float) -> tuple[FakeGripper, SimulatedClock]:
    clock = SimulatedClock()
    made = FakeGripper(world(), clock, FaultScript(()), period_s=period_s)
    made.connect()
    made.activate()
    return made, clock


@pytest.mark.parametrize("counts", [1, 6, 60])
def test_finger_motion_is_delayed_by_one_line_period_at_both_ends(counts: int) -> None:
    made, clock = gripper(PERIOD_S)
    began = clock.now_ns()
    motion = made.move_to(opening_m(made, OPEN_COUNTS + counts))
    clock.sleep_until(began + to_ns(PERIOD_S))
    assert counts_of(made) == OPEN_COUNTS
    assert made.state().moving
    motion.wait(5.0)
    ramp_s = min(SPEED_COUNTS_S / ACCELERATION_COUNTS_S2, (counts / ACCELERATION_COUNTS_S2) ** 0.5)
    closing_s = 2 * ramp_s + max(counts - ACCELERATION_COUNTS_S2 * ramp_s**2, 0.0) / SPEED_COUNTS_S
    assert (clock.now_ns() - began) / 1e9 == pytest.approx(closing_s + 2 * PERIOD_S, abs=0.005)
    assert counts_of(made) == OPEN_COUNTS + counts


def test_fingers_go_at_the_speed_and_stall_at_the_force_that_is_commanded() -> None:
    made, clock = gripper(0.0)
    began = clock.now_ns()
    made.move_to(made.spec.open_m - 0.05, speed_m_s=0.05).wait(5.0)
    assert (clock.now_ns() - began) / 1e9 == pytest.approx(1.0, abs=0.05)
    pressed_n = []
    for force_n in (15.0, 18.0):
        bench, clock = world(), SimulatedClock()
        bench.place(find_object("t1"))
        bench.tool = ToolPath.resting(Pose((0.45, 0.0, 0.05), (1.0, 0.0, 0.0, 0.0)))
        made = FakeGripper(bench, clock, FaultScript(()))
        made.connect()
        made.activate()
        made.move_to(0.0).wait(10.0)  # in contact
        made.move_to(made.spec.closed_m, force_n=force_n).wait(10.0)
        assert made.state().gripping
        pressed_n.append(FINGER_STIFFNESS_N_M * bench.squeeze_at(clock.now_ns()))
    assert pressed_n == pytest.approx([15.0, 18.0], abs=0.1)


def test_stopped_arm_travels_its_braking_distance() -> None:
    bench, clock = world(), SimulatedClock()
    arm = FakeArm(bench, clock, FaultScript(()))
    arm.connect()
    speed_m_s = 0.2
    arm.move_linear(arm.state().base_T_tcp.translated(z_m=0.2), speed_m_s, 1.0)
    clock.sleep_until(clock.now_ns() + to_ns(0.5))
    told_m = arm.state().base_T_tcp.position_m[2]
    arm.stop()
    clock.sleep_until(clock.now_ns() + to_ns(1.0))
    way_m = arm.state().base_T_tcp.position_m[2] - told_m
    assert way_m == pytest.approx(speed_m_s**2 / (2 * STOP_DECELERATION_M_S2), rel=0.01)
