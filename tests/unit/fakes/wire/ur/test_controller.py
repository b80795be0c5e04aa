"""The simulated controller: its time, its end, unknown faults, and clients that misbehave.

Its faults are tested with the driver, in tests/scenario/ur5e.
"""

import socket

import pytest

from fakes.wire.ur.controller import URController
from fakes.wire.ur.robot import Safety
from support.ur_clients import Connect
from support.waiting import until


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


def test_invalid_bytes_end_that_connection_only(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    with socket.create_connection((controller.host, 30004), timeout=120) as connection:
        connection.sendall(b"\x00\x00\x00garbage")
        assert connection.recv(10) == b""
    assert client.timestamp() > 0.0


def test_client_that_does_not_read_is_closed_without_delaying_others(
    controller: URController, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.controller.GIVE_UP_S", 0.1)
    names = ",".join(f"output_double_register_{i}" for i in range(48))
    connect(controller.host, names)
    client = connect(controller.host)
    until(lambda: client.timestamp() > 0.0 and controller.snapshot()["clients"] == 1, limit_s=20.0)
