"""Commands and statuses between the driver and its connection, without a gripper."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceTimeoutError
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from drivers.robotiq_3f.modbus import GripperLine, StatusSample
from drivers.robotiq_3f.registers import AxisState, GraspMode, MotionStatus, ObjectStatus, Stage, Status


def test_command_that_was_reported_as_not_sent_is_never_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.robotiq_3f.modbus.ANSWER_S", 0.02)
    line = GripperLine(tcp_link("127.0.0.1", 1), SystemClock())  # nothing carries out its commands
    sent: list[Any] = []
    line.requests = SimpleNamespace(write_command=sent.append)  # type: ignore[assignment]
    with pytest.raises(DeviceTimeoutError, match="not acknowledged"):
        line.send((1,) * 8)
    line._carry_out_next()
    assert sent == []


@pytest.mark.parametrize("finger", ["A", "B", "C"])
def test_one_finger_that_has_met_the_object_is_a_grip(monkeypatch: pytest.MonkeyPatch, finger: str) -> None:
    axes = tuple(
        AxisState(90, 80, 10, ObjectStatus.CONTACT_CLOSING if name == finger else ObjectStatus.AT_REQUEST)
        for name in "ABCS"
    )
    status = Status(True, GraspMode.BASIC, True, Stage.READY, MotionStatus.SOME_STOPPED_EARLY, 0, axes)
    gripper = Robotiq3F(tcp_link("127.0.0.1", 1), fingers=("A", "B", "C"))
    connected = SimpleNamespace(sample=lambda: StatusSample(0, status))
    monkeypatch.setattr(gripper, "_require_line", lambda: connected)
    assert gripper.state().gripping
