"""The simulated controller's clients: what they are sent, and those that misbehave."""

import socket
import struct
import time

import numpy as np
import pytest

from fakes.wire.ur.controller import URController
from support.ur_clients import Connect, ask_dashboard
from support.waiting import until


def test_nonsense_ends_that_connection_only(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    with socket.create_connection((controller.host, 30004), timeout=2.0) as connection:
        connection.sendall(b"\x00\x00\x00garbage")
        assert connection.recv(10) == b""
    assert client.timestamp() > 0.0


def test_a_client_that_does_not_read_does_not_hold_up_the_others(
    controller: URController, connect: Connect
) -> None:
    names = ",".join(f"output_double_register_{i}" for i in range(48))
    connect(controller.host, names)
    client = connect(controller.host)
    before = client.timestamp()
    until(lambda: client.timestamp() - before > 1.0)


@pytest.mark.parametrize(
    ("port", "length", "period_s"), [(30001, 1290, 0.1), (30002, 1290, 0.1), (30003, 1220, 0.002)]
)
def test_client_interfaces_send_their_state(
    controller: URController, port: int, length: int, period_s: float
) -> None:
    with socket.create_connection((controller.host, port), timeout=2.0) as connection:
        stream = connection.makefile("rb")
        if port != 30003:
            size, kind = struct.unpack(">iB", stream.read(5))
            assert kind == 20, "the version comes first"
            stream.read(size - 5)
        stamps = []
        for _ in range(6):
            (size,) = struct.unpack(">i", stream.read(4))
            assert size == length
            body = stream.read(size - 4)
            time_at = (
                struct.unpack_from(">d", body)[0]
                if port == 30003
                else 1e-6 * struct.unpack_from(">Q", body, 6)[0]
            )
            stamps.append(time_at)
        assert np.diff(stamps) == pytest.approx(period_s, abs=1e-6)


def test_a_client_interface_may_be_left_unread(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ur-rtde leaves it: it sends programs there, minutes apart, and never reads."""
    monkeypatch.setattr("fakes.wire.ur.connections.GIVE_UP_S", 0.1)
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect((controller.host, 30003))
        until(lambda: any(c.behind for c in controller._connections))
        time.sleep(0.3)
        connection.sendall(b"def mine():\n sleep(10)\nend\n")
        until(lambda: controller.snapshot()["program_running"])


def test_a_client_of_the_data_exchange_that_does_not_read_is_closed(
    controller: URController, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.connections.GIVE_UP_S", 0.1)
    names = ",".join(f"output_double_register_{i}" for i in range(48))
    connect(controller.host, names)
    assert controller.snapshot()["clients"] == 1
    until(lambda: controller.snapshot()["clients"] == 0, limit_s=20.0)


def test_answers_that_nobody_fetches_do_not_pile_up(
    controller: URController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.connections.MOST_PENDING", 10_000)
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect((controller.host, 29999))
        connection.settimeout(10.0)
        with pytest.raises(ConnectionError):
            connection.sendall(b"robotmode\n" * 10_000_000)
    assert ask_dashboard(controller.host, b"robotmode") == b"Robotmode: RUNNING\n"


def test_more_clients_than_it_takes_are_turned_away(
    controller: URController, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.wire.ur.controller.MOST_CLIENTS", 1)
    client = connect(controller.host)
    with socket.create_connection((controller.host, 30004), timeout=2.0) as connection:
        assert connection.recv(1) == b""
    assert client.timestamp() > 0.0
