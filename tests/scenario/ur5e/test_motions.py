"""The UR5e's driver on the simulated controller: connecting, motions, stops, limits, force and time."""

import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.bench import Hand
from drivers.clock import to_ns
from drivers.errors import ContactForceError, DeviceError, OperatorStopError, OutOfLimitsError
from drivers.types import HandState, Holding, Pose
from drivers.ur5e.arm import UR5e
from fakes.wire.ur.controller import URController
from fakes.world.kinematics import TOOL_LENGTH_M, from_ur
from protocols.steps import move
from support.benches import NOISE_M
from support.marks import heavy, require_ur_rtde
from support.slow_motion import CLOCK, SLOWNESS, pause
from support.ur5e import agree, make_arm, refuse, stands
from support.waiting import until
from support.worlds import HOME

pytestmark = pytest.mark.heavy

require_ur_rtde()
Start = Callable[..., URController]


@pytest.mark.parametrize("version", ["5.4.0", *heavy("5.5.1", "5.11.0", "5.25.0")])
def test_motion_works_on_all_supported_controller_versions(started: Start, version: str) -> None:
    arm = make_arm(started(version).host)
    arm.connect()
    motion = arm.move_linear(HOME.translated(z_m=-0.05), 0.25, 1.0)
    assert motion.progress() < 0.9
    motion.wait(5.0)
    assert motion.progress() == 1.0
    assert arm.state().base_T_tcp.position_m == pytest.approx((0.45, 0.0, 0.25), abs=1e-4)
    assert arm.identity()["firmware"].startswith(version)


def test_connecting_moves_nothing_and_sets_up_tool_and_times(controller: URController, arm: UR5e) -> None:
    assert arm.state().base_T_tcp.position_m == pytest.approx(HOME.position_m, abs=NOISE_M)
    assert controller.robot.body.tool[2] == pytest.approx(TOOL_LENGTH_M)
    assert set(controller.snapshot()["commands"]) <= {"17", "29", "35", "40"}
    assert arm.identity()["serial"].isdecimal()
    dates = [arm.state().time_ns for _ in range(2000)]
    assert dates == sorted(dates)
    assert 0 <= CLOCK.now_ns() - arm.state().time_ns < to_ns(0.2), "on the rig's clock"
    assert arm.counters()["samples"] > 0
    assert arm.clock_offset_s() < 0.0


def test_program_on_the_controller_is_replaced_unless_it_moves_the_arm(controller: URController) -> None:
    arm = make_arm(controller.host)
    with socket.create_connection((controller.host, 30003)) as scripts:
        scripts.sendall(b"def wait():\n  sleep(60)\nend\n")
        until(lambda: controller.snapshot()["program_running"])
    arm.connect()
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)
    arm.disconnect()
    with socket.create_connection((controller.host, 30003)) as scripts:
        scripts.sendall(b"def sweep():\n  movel(p[0.45, 0, 0.1, 3.1415926, 0, 0], a=1, v=0.02)\nend\n")
        until(lambda: controller.snapshot()["tcp_m"][2] < 0.289)
        with pytest.raises(DeviceError, match="a program moves it"):
            arm.connect()
    assert controller.snapshot()["program_running"]


def test_two_arms_in_one_program_are_independent(started: Start) -> None:
    # both start before either arm connects, because a start keeps this process busy
    arms = [make_arm(controller.host) for controller in (started(), started())]
    for arm in arms:
        arm.connect()
    for arm, z_m in zip(arms, (-0.05, 0.05), strict=True):
        arm.move_linear(HOME.translated(z_m=z_m), 0.25, 1.0).wait(5.0)
    heights = [arm.state().base_T_tcp.position_m[2] for arm in arms]
    assert heights == pytest.approx([0.25, 0.35], abs=1e-4)


def test_stop_from_another_thread_ends_the_motion(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    stopper = threading.Timer(0.3 * SLOWNESS, arm.stop)
    stopper.start()
    motion.wait(5.0)
    stopper.join()
    assert motion.is_done()
    assert 0.2 < arm.state().base_T_tcp.position_m[2] < 0.299
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


def test_stop_during_the_preparation_prevents_a_motion_and_disconnecting_stops_one(
    controller: URController, arm: UR5e, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.ur5e.arm.check_joints", lambda *_: arm.stop())
    with pytest.raises(DeviceError, match="not sent"):
        arm.move_linear(HOME.translated(z_m=-0.1), 0.1, 1.0)
    assert "3" not in controller.snapshot()["commands"]
    monkeypatch.undo()
    arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    arm.disconnect()
    assert stands(controller)
    assert not controller.snapshot()["program_running"]


def test_motion_out_of_reach_or_joint_limits_is_rejected_and_the_program_continues(
    controller: URController,
) -> None:
    low, sideways = HOME.translated(z_m=-0.01), Pose((0.7, 0.35, 0.02), (0.7, 0.0, 0.0, 0.7))
    narrow: Any = ((-0.1,) * 6, (0.1,) * 6)
    for limits, pose, said in ((narrow, low, "joint 1"), (None, sideways, "reach")):
        arm = make_arm(controller.host, joint_limits_rad=limits)
        arm.connect()
        with pytest.raises(OutOfLimitsError, match=said):
            arm.move_linear(pose, 0.1, 1.0)
        assert "3" not in controller.snapshot()["commands"], "no motion was sent"
        if limits is None:
            arm.move_linear(low, 0.25, 1.0).wait(5.0)
        arm.disconnect()


def test_the_force_sensor_is_zeroed_at_rest_only(controller: URController, arm: UR5e) -> None:
    arm.move_linear(HOME.translated(z_m=-0.02), 0.25, 1.0).wait(5.0)
    with pytest.raises(DeviceError, match="not at rest"):
        arm.zero_force_sensor()
    pause(0.7)
    arm.zero_force_sensor()
    assert np.linalg.norm(arm.state().wrench[:3]) < 0.6


def test_different_tool_on_the_controller_is_overwritten_only_after_a_question(
    controller: URController,
) -> None:
    installed = controller.robot.bank.get("payload")
    arm = make_arm(controller.host, payload_kg=1.8)
    arm.connect()
    assert controller.robot.bank.get("payload") == installed
    with pytest.raises(DeviceError, match=r"2\.500 kg instead of 1\.800 kg"):
        arm.move_linear(HOME.translated(z_m=-0.01), 0.1, 1.0)

    with pytest.raises(
        OperatorStopError, match=r"payload 2\.500 kg instead of 1\.800 kg.*should the rig set it"
    ):
        arm.recover(refuse)
    assert controller.robot.bank.get("payload") == installed
    assert "3" not in controller.snapshot()["commands"], "no motion was sent"
    arm.recover(agree)
    assert controller.robot.bank.get("payload") == 1.8
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)
    arm.recover(lambda question: pytest.fail(question))


def test_different_tcp_of_the_installation_causes_a_question(controller: URController) -> None:
    ours = controller.robot.body.tool
    controller.robot.set_tool(from_ur((0.0, 0.0, 0.20, 0.0, 0.0, 0.0)))
    arm = make_arm(controller.host)
    arm.connect()
    asked: list[str] = []
    arm.recover(asked.append)
    assert "TCP (0, 0, 0.2, 0, 0, 0) instead of (0, 0, 0.28, 0, 0, 0)" in asked[0]
    assert controller.robot.body.tool == pytest.approx(ours)


def test_the_speed_slider_is_read_before_and_while_the_arm_is_connected(controller: URController) -> None:
    arm = make_arm(controller.host)
    assert arm.speed_fraction() == 1.0
    controller.robot.write_inputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.4})
    assert arm.speed_fraction() == 0.4
    assert "3" not in controller.snapshot()["commands"]
    arm.connect()
    assert arm.state().speed_fraction == 0.4
    controller.robot.write_inputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.7})
    until(lambda: arm.state().speed_fraction == 0.7)


def test_descent_is_stopped_at_the_table(controller: URController, arm: UR5e) -> None:
    table_m = 0.2
    world = controller.robot._world
    world.layout = replace(world.layout, floor_z_m=table_m)
    gripper = SimpleNamespace(state=lambda: None)
    bench: Any = SimpleNamespace(arm=arm, clock=CLOCK, hand=Hand(HandState(Holding.FREE)), gripper=gripper)
    with pytest.raises(ContactForceError, match="met an obstacle on its way down"):
        move(bench, HOME.translated(z_m=-0.15), 0.25).wait(5.0)
    assert stands(controller)
    assert table_m - 0.020 < controller.snapshot()["tcp_m"][2] < table_m
