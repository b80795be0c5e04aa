"""Grips: an object between the fingers stops them; one-count steps hold it lightly."""

import pytest

from drivers.clock import SystemClock
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from drivers.types import Pose
from fakes.objects.catalogue import find_object
from fakes.wire.gripper.server import GripperServer
from fakes.world.motion import ToolPath
from fakes.world.world import FINGER_STIFFNESS_N_M, BenchLayout, World
from support.finger_counts import counts_of, opening_m

TABLE = Pose((0.45, 0.0, 0.06))
TOOL_DOWN = (1.0, 0.0, 0.0, 0.0)


class HurriedClock(SystemClock):
    """The world's time, five times as fast as ours, so that nobody waits for fingers."""

    def now_ns(self) -> int:
        return 5 * super().now_ns()


def make_world() -> World:
    """The hand stands around the wrench."""
    world = World(BenchLayout(base_T_table=TABLE, home=Pose((0.45, 0.0, 0.30), TOOL_DOWN)), seed=3)
    world.place(find_object("t1"))
    world.tool = ToolPath.resting(Pose(TABLE.position_m, TOOL_DOWN))
    return world


def test_an_object_stops_the_fingers_and_they_can_be_opened_again() -> None:
    world = make_world()
    server = GripperServer(world, HurriedClock(), activation_s=0.1)
    server.start()
    gripper = Robotiq3F(tcp_link(*server.address), speed_m_s=0.11)
    gripper.connect()
    gripper.activate()
    gripper.move_to(opening_m(gripper, 255)).wait(5.0)
    held = gripper.state()
    assert held.raw["position_counts"] < 250
    squeeze_m = world.squeeze_at(HurriedClock().now_ns())
    assert squeeze_m * FINGER_STIFFNESS_N_M == pytest.approx(15.0, abs=1.0), "rFR = 0"
    gripper.move_to(opening_m(gripper, held.raw["position_counts"] + 5)).wait(2.0)
    assert counts_of(gripper) == held.raw["position_counts"], "in contact it goes no further"
    gripper.move_to(opening_m(gripper, 6)).wait(5.0)
    assert counts_of(gripper) == 6
    gripper.disconnect()
    server.stop()


def test_one_count_steps_with_a_stop_from_outside_are_a_light_grip() -> None:
    """How `protocols.steps.close_to_contact` closes; here the world says what a gel would show."""
    world, clock = make_world(), HurriedClock()
    server = GripperServer(world, clock, activation_s=0.1)
    server.start()
    gripper = Robotiq3F(tcp_link(*server.address), speed_m_s=0.11)
    gripper.connect()
    gripper.activate()
    width = find_object("t1").sites[0].width_m
    counts = round(6 + (0.120 - width - 0.003) / world.layout.opening_per_count_m)
    gripper.move_to(opening_m(gripper, counts)).wait(5.0)
    while world.squeeze_at(clock.now_ns()) == 0.0:
        counts += 1
        gripper.move_to(opening_m(gripper, counts)).wait(2.0)
        assert counts_of(gripper) == counts
    assert FINGER_STIFFNESS_N_M * world.squeeze_at(clock.now_ns()) < 0.5, "N; rFR = 0 is 15 N"
    gripper.disconnect()
    server.stop()
