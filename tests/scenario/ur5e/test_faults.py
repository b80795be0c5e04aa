"""The UR5e's driver in protective stops and in every fault, at connect and in mid-motion."""

from collections.abc import Callable
from typing import Any

import pytest

from drivers.errors import (
    DeviceError,
    InvalidStateError,
    NotConnectedError,
    OperatorStopError,
    ProtectiveStopError,
)
from drivers.types import ArmMode
from drivers.ur5e.arm import ToolSetting, UR5e
from drivers.ur5e.link import ArmLink
from drivers.ur5e.status import PLAYING
from fakes.wire.ur.controller import URController
from support.marks import heavy, require_ur_rtde
from support.ur5e import agree, first_error, make_arm, refuse, stands
from support.waiting import until
from support.worlds import HOME

require_ur_rtde()


@pytest.mark.heavy
def test_protective_stop_is_released_on_request_only(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    controller.inject("protective_stop")
    error = first_error(motion.is_done)
    assert isinstance(error, ProtectiveStopError)
    assert arm.state().mode is ArmMode.PROTECTIVE_STOP

    with pytest.raises(OperatorStopError):
        arm.recover(refuse)
    assert arm.state().mode is ArmMode.PROTECTIVE_STOP
    arm.recover(agree)
    assert arm.state().mode is ArmMode.RUNNING
    assert stands(controller), "recovery moves nothing"
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


@pytest.mark.heavy
def test_connecting_during_a_protective_stop_and_recovery_work(controller: URController) -> None:
    controller.inject("protective_stop")
    arm = make_arm(controller.host)
    arm.connect()
    with pytest.raises(ProtectiveStopError):
        arm.move_linear(HOME, 0.1, 1.0)
    arm.recover(agree)
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)


@pytest.mark.heavy
def test_program_that_ends_before_the_tool_is_known_is_restarted(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    kill = iter([True])

    def compare(tool: ToolSetting, link: ArmLink) -> bool:
        if next(kill, False):
            controller.inject("program_killed")
            until(lambda: link.sample().runtime_state != PLAYING)
        return original(tool, link)

    original = ToolSetting.compare
    monkeypatch.setattr(ToolSetting, "compare", compare)
    arm = make_arm(controller.host)
    arm.connect()
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        ("program_killed", {}, "control program is stopped"),
        ("stream_frozen", {}, "state is unknown"),
        *heavy(("stream_frozen", {"repeat": True}, "state is unknown")),
        ("socket_dropped", {}, "connection lost"),
        *heavy(("silent", {}, "state is unknown")),
        ("emergency_stop", {}, "emergency stop"),
    ],
)
def test_fault_in_mid_motion_is_named_and_stops_the_arm(
    controller: URController, arm: UR5e, kind: str, arguments: dict[str, bool], said: str
) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.25), 0.1, 1.0)
    until(lambda: motion.progress() > 0.05)
    controller.inject(kind, **arguments)
    error = first_error(motion.is_done)
    assert said in str(error)
    arm.stop()
    assert stands(controller)
    with pytest.raises(DeviceError):
        arm.move_linear(HOME, 0.1, 1.0)
    arm.disconnect()
    controller.inject("clear")
    if kind == "emergency_stop":
        with pytest.raises(DeviceError, match="power off"):
            arm.connect()
        return
    arm.connect()
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        ("silent", {}, "does not answer"),
        *heavy(("stream_frozen", {}, "does not answer")),
        ("stream_frozen", {"repeat": True}, "time stands still|does not answer"),
        ("remote_control_off", {}, "remote control is off"),
        ("recipe_refused", {"reply": "IN_USE"}, "already in use"),
        ("recipe_refused", {"reply": "NOT_FOUND"}, "NOT_FOUND"),
        ("recipe_refused", {"reply": "NOT_FOUND", "prefix": "actual_q"}, "no state.*actual_q"),
        ("emergency_stop", {}, "emergency stop"),
    ],
)
def test_fault_at_connect_is_named_at_once(
    controller: URController, monkeypatch: pytest.MonkeyPatch, kind: str, arguments: dict[str, Any], said: str
) -> None:
    monkeypatch.setattr("drivers.ur5e.link.STREAM_START_S", 1.0)
    controller.inject(kind, **arguments)
    arm = make_arm(controller.host)
    with pytest.raises(DeviceError, match=said):
        arm.connect()
    with pytest.raises(NotConnectedError):
        arm.state()


def test_old_polyscope_is_named_before_any_process_starts(
    started: Callable[..., URController], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.ur5e.link.ChildProcess", lambda *_: pytest.fail("a process was started"))
    with pytest.raises(DeviceError, match=r"PolyScope 5\.3, which is too old"):
        make_arm(started("5.3.9").host).connect()


@pytest.mark.heavy
def test_local_control_of_the_pendant_prevents_the_start(controller: URController, arm: UR5e) -> None:
    controller.inject("remote_control_off")
    with pytest.raises(DeviceError, match="remote control is off"):
        arm.move_linear(HOME.translated(z_m=-0.01), 0.1, 1.0)
    assert "3" not in controller.snapshot()["commands"]


@pytest.mark.heavy
@pytest.mark.parametrize("value", [float("nan"), *heavy(float("inf"))])
def test_invalid_wrench_from_the_controller_stops_a_motion(
    controller: URController, arm: UR5e, monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    until(lambda: arm.state().base_T_tcp.position_m[2] < HOME.position_m[2] - 0.02)
    with monkeypatch.context() as broken:
        broken.setattr(controller.robot.force, "sense", lambda *_: (value, 0.0, 500.0, 0.0, 0.0, 0.0))
        with pytest.raises(InvalidStateError, match="the arm's wrench is"):
            motion.wait(5.0)
        with pytest.raises(InvalidStateError, match="the arm's wrench is"):
            arm.state()
    assert stands(controller)
    assert controller.snapshot()["tcp_m"][2] > HOME.position_m[2] - 0.1
