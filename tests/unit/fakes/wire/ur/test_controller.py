"""The simulated controller: its time, its end, unknown faults, and clients that misbehave.

Its faults are tested with the driver, in tests/scenario/ur5e.
"""

import itertools
import socket

import pytest

from drivers.errors import InputError
from fakes.wire.ur.controller import URController
from support.ur_clients import Connect, ask_dashboard, make
from support.waiting import until


def test_time_stamps_are_control_cycles(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    stamps = [client.timestamp() for _ in range(100)]
    steps = {round((b - a) * 500, 6) for a, b in itertools.pairwise(stamps)}
    assert steps == {1.0}


def test_port_in_use_is_named() -> None:
    first = make()
    first.start()
    second = make(host=first.host)
    with pytest.raises(InputError, match=r"cannot listen.*own address"):
        second.start()
    first.stop()
    second.start()
    second.stop()


def test_controller_can_be_started_again(controller: URController, connect: Connect) -> None:
    controller.stop()
    controller.stop()
    controller.start()
    assert connect(controller.host).timestamp() > 0.0


@pytest.mark.parametrize(
    ("kind", "arguments"), [("fire", {}), ("silent", {"repeat": True}), ("recipe_refused", {"reply": "NO"})]
)
def test_unknown_fault_is_rejected(controller: URController, kind: str, arguments: dict[str, object]) -> None:
    with pytest.raises(InputError, match="simulated controller"):
        controller.inject(kind, **arguments)


def test_failure_of_the_controller_is_reported(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert controller.failure is None
    monkeypatch.setattr(controller.robot, "cycle", lambda time_ns: 1 / 0)
    until(lambda: isinstance(controller.failure, ZeroDivisionError))


def test_invalid_bytes_end_that_connection_only(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    with socket.create_connection((controller.host, 30004), timeout=2.0) as connection:
        connection.sendall(b"\x00\x00\x00garbage")
        assert connection.recv(10) == b""
    assert client.timestamp() > 0.0


def test_client_that_does_not_read_is_closed_without_delaying_others(
    controller: URController, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.connections.GIVE_UP_S", 0.1)
    names = ",".join(f"output_double_register_{i}" for i in range(48))
    connect(controller.host, names)
    client = connect(controller.host)
    until(lambda: client.timestamp() > 0.0 and controller.snapshot()["clients"] == 1, limit_s=20.0)


def test_unread_answers_do_not_pile_up(controller: URController, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fakes.wire.ur.connections.MOST_PENDING", 10_000)
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect((controller.host, 29999))
        connection.settimeout(10.0)
        with pytest.raises(ConnectionError):
            connection.sendall(b"robotmode\n" * 10_000_000)
    assert ask_dashboard(controller.host, b"robotmode") == b"Robotmode: RUNNING\n"


def test_clients_beyond_the_limit_are_rejected(
    controller: URController, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.controller.MOST_CLIENTS", 1)
    client = connect(controller.host)
    with socket.create_connection((controller.host, 30004), timeout=2.0) as connection:
        assert connection.recv(1) == b""
    assert client.timestamp() > 0.0
