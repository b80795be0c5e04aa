"""Faults of the gripper and its line are reported, and cleared by reconnecting."""

import re
import socket
import time
from contextlib import suppress

import pytest

from drivers.errors import DeviceError, DeviceTimeoutError, GripperFaultError, NotConnectedError
from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link
from drivers.robotiq_3f.modbus import Link
from fakes.wire.gripper.server import GripperServer
from support.connected import connected
from support.finger_counts import counts_of, opening_m
from support.gripper_on_wire import Wire, raised_by
from support.waiting import until

FAULTS: list[tuple[str, dict[str, object], type[DeviceError], str]] = [
    ("silent", {}, DeviceTimeoutError, "reply"),
    ("delay", {"delay_s": 1.75}, DeviceTimeoutError, "reply"),
    ("truncate", {"size": 4}, DeviceTimeoutError, "reply"),
    ("garbage", {}, DeviceError, "check power"),
    ("exception", {"code": 2}, DeviceError, "exception 2"),
    ("disconnect", {}, DeviceError, "cannot be opened|the line failed"),  # by the first request that fails
    ("fault", {"code": 0x0E}, GripperFaultError, "0x0E"),
    ("fault", {"code": 0x0A}, GripperFaultError, "0x0A"),
    ("power_lost", {"duration_s": 0.1}, DeviceError, "activation"),
]


@pytest.mark.parametrize(("kind", "arguments", "expected", "said"), FAULTS)
def test_fault_in_a_motion_is_reported_and_cleared_by_reconnecting(
    wire: tuple[Wire, Link], kind: str, arguments: dict[str, object], expected: type[DeviceError], said: str
) -> None:
    fake, link = wire
    with connected(Robotiq3F(link, speed_m_s=0.022)) as gripper:
        gripper.activate()
        motion = gripper.move_to(opening_m(gripper, 255))
        fake.inject(kind, **arguments)
        error = raised_by(motion.is_done)
        assert isinstance(error, expected)
        assert re.search(said, str(error))
        fake.inject("clear")
    time.sleep(0.05)
    gripper.connect()
    gripper.activate()
    gripper.move_to(opening_m(gripper, 20)).wait(5.0)
    assert counts_of(gripper) == 20
    gripper.disconnect()


def test_obstacle_during_activation_is_fault_13(server: GripperServer) -> None:
    server.inject("blocked")
    with connected(Robotiq3F(tcp_link(*server.address))) as gripper:
        with pytest.raises(GripperFaultError, match="free the fingers") as raised:
            gripper.activate()
        assert raised.value.code == 0x0D
        server.inject("clear")
        gripper.activate()
        assert gripper.state().activated


def test_reading_resumes_when_the_line_recovers(gripper: Robotiq3F, server: GripperServer) -> None:
    gripper.move_to(opening_m(gripper, 30)).wait(5.0)
    server.inject("silent")
    assert isinstance(raised_by(gripper.state), DeviceTimeoutError)
    server.inject("clear")
    read: list[int] = []

    def answers() -> bool:
        with suppress(DeviceTimeoutError):
            read.append(counts_of(gripper))
        return bool(read)

    until(answers)
    assert read == [30]


def test_address_without_a_gripper_is_reported_quickly() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        silent = Robotiq3F(tcp_link("127.0.0.1", port))
        assert isinstance(raised_by(silent.connect), DeviceTimeoutError)
    closed = Robotiq3F(tcp_link("127.0.0.1", port))
    assert "cannot be opened" in str(raised_by(closed.connect))
    with pytest.raises(NotConnectedError):
        closed.state()
    missing = Robotiq3F(rtu_link("/dev/no-such-line"))
    assert "cannot be opened" in str(raised_by(missing.connect))
