"""The simulated controller: its end, the release of a stop, and clients that misbehave.

Its faults are tested with the driver, in tests/scenario/ur5e.
"""

import socket
import struct
from collections.abc import Iterator

import pytest

from fakes.wire.ur.controller import URController
from fakes.wire.ur.robot import Safety
from fakes.wire.ur.rtde import package
from support.ur5e import make_controller
from support.waiting import until


@pytest.fixture
def controller() -> Iterator[URController]:
    controller = make_controller()
    controller.start()
    yield controller
    controller.stop()


def connected(controller: URController, names: str = "timestamp") -> socket.socket:
    """Return a connection on which 500 data packages per second arrive."""
    connection = socket.create_connection((controller.host, 30004), timeout=120)
    outputs = struct.pack(">d", 500.0) + names.encode()
    connection.sendall(package(ord("V"), b"\0\2") + package(ord("O"), outputs) + package(ord("S")))
    return connection


def test_failure_of_the_controller_is_reported(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert controller.failure is None
    monkeypatch.setattr(controller.robot, "cycle", lambda time_ns: 1 / 0)
    until(lambda: isinstance(controller.failure, ZeroDivisionError))


def test_protective_stop_is_released_after_its_time_only() -> None:
    safety = Safety(release_after_s=5.0)
    safety.protective_stop(10_000_000_000)
    assert (safety.unlock(14_900_000_000), safety.may_move) == (False, False)
    assert (safety.unlock(15_000_000_000), safety.may_move) == (True, True)


def test_invalid_bytes_end_that_connection_only(controller: URController) -> None:
    with connected(controller) as client, connected(controller) as other:
        other.sendall(b"\x00\x00\x00garbage")
        while other.recv(4096):
            pass
        client.sendall(package(ord("v")))
        until(lambda: b"\x00\x13v" in client.recv(65536))


@pytest.mark.heavy
def test_client_that_does_not_read_is_closed_without_delaying_others(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.controller.GIVE_UP_S", 0.1)
    names = ",".join(f"output_double_register_{i}" for i in range(48))
    with connected(controller, names), connected(controller) as client:
        until(lambda: controller.snapshot()["clients"] == 2)
        until(lambda: client.recv(65536) != b"" and controller.snapshot()["clients"] == 1)
