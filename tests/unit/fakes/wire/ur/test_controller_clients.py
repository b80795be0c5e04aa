"""The simulated controller's clients: what they are sent, and those that misbehave."""

import socket

import pytest

from fakes.wire.ur.controller import URController
from support.ur_clients import Connect, ask_dashboard
from support.waiting import until


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
