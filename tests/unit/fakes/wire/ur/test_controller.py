"""The simulated controller: its time, its state, and faults on request."""

import itertools
import socket
import struct
import time

import pytest

from drivers.errors import InputError
from fakes.wire.ur.controller import URController
from support.ur_clients import Connect, make
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


def test_frozen_stream_sends_nothing_until_cleared(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    controller.inject("stream_frozen")
    client.socket.settimeout(0.3)
    with pytest.raises(TimeoutError):
        client.read_on()
    controller.inject("clear")
    client.timestamp()


def test_frozen_stream_can_repeat_itself(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    client.timestamp()
    controller.inject("stream_frozen", repeat=True)
    until(lambda: client.timestamp() == client.timestamp())
    assert len({client.timestamp() for _ in range(50)}) == 1


def test_dropped_connections_end_and_new_ones_are_accepted(
    controller: URController, connect: Connect
) -> None:
    client = connect(controller.host)
    controller.inject("socket_dropped")
    with pytest.raises((EOFError, ConnectionError)):
        client.read_on()
    assert connect(controller.host).timestamp() > 0.0


def test_silent_controller_accepts_connections_without_answering(controller: URController) -> None:
    controller.inject("silent")
    with socket.create_connection((controller.host, 30004), timeout=0.3) as connection:
        connection.sendall(b"\x00\x05V\x00\x02")
        with pytest.raises(TimeoutError):
            connection.recv(1)
    with (
        socket.create_connection((controller.host, 29999), timeout=0.3) as connection,
        pytest.raises(TimeoutError),
    ):
        connection.recv(1)


@pytest.mark.parametrize("reply", ["NOT_FOUND", "IN_USE"])
def test_recipes_can_be_refused(controller: URController, reply: str) -> None:
    controller.inject("recipe_refused", reply=reply)
    with socket.create_connection((controller.host, 30004), timeout=2.0) as connection:
        connection.sendall(b"\x00\x17I" + b"input_int_register_0")
        assert connection.recv(100) == struct.pack(">Hc", 4 + len(reply), b"I") + b"\x00" + reply.encode()


def test_local_control_refuses_programs(controller: URController) -> None:
    controller.inject("remote_control_off")
    with socket.create_connection((controller.host, 30003), timeout=2.0) as connection:
        connection.sendall(b"def mine():\n sleep(10)\nend\n")
        time.sleep(0.1)
        assert not controller.snapshot()["program_running"]
        controller.inject("clear")
        connection.sendall(b"def mine():\n sleep(10)\nend\n")
        until(lambda: controller.snapshot()["program_running"])
    controller.inject("program_killed")
    until(lambda: not controller.snapshot()["program_running"])


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
