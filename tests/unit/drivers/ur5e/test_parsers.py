"""Every parser of the arm with random bytes, truncated or mixed packages: typed errors, never a hang."""

import io
import json
import os
import random
import socket
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, InputError, OperatorStopError
from drivers.ur5e.controller import parse_version, read_package
from drivers.ur5e.heartbeat import Heartbeat, Program
from drivers.ur5e.link import ControlClient
from drivers.ur5e.processes import ControlCommands, answer
from drivers.ur5e.shared_state import SharedState
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.script import LineReader, reply
from support.worlds import empty_world

Cases = Callable[[int], int]


@pytest.mark.fuzz
def test_any_dashboard_line_is_parsed_or_rejected(cases: Cases) -> None:
    rng, reader = random.Random(3), LineReader()
    robot = Robot(empty_world(), (5, 25, 0, 0))
    requests = ["running", "robotmode", "stop", "unlock protective stop", "power on", "popup"]
    for _ in range(cases(20_000)):
        known = rng.choice(requests).encode()
        data = rng.choice((known, known[: rng.randrange(9)], rng.randbytes(rng.randrange(40)))) + rng.choice(
            (b"\n", b"")
        )
        try:
            replies = [reply(robot, line) for line in reader.feed(data)]
        except InputError:
            reader = LineReader()
            continue
        for answered in replies:
            assert "\n" not in answered


def delivered(data: bytes, rng: random.Random) -> Callable[[int], bytes]:
    """Return a function that reads bytes in pieces until the connection is closed."""
    stream = io.BytesIO(data)

    def read(most: int) -> bytes:
        if part := stream.read(rng.randint(1, most) if most else 0):
            return part
        raise DeviceError("arm: closed")

    return read


@pytest.mark.fuzz
def test_any_first_package_is_parsed_or_rejected(cases: Cases) -> None:
    rng = random.Random(4)
    for _ in range(cases(25_000)):
        good = struct.pack(">HB", 19, ord("v")) + struct.pack(">4I", 5, 11, 0, 0)
        data = rng.choice(
            (good, good[: rng.randrange(19)], rng.randbytes(rng.randrange(30)), b"\x00\x03v", b"\xff\xffV")
        )
        try:
            kind, payload = read_package(delivered(data, rng))
            assert len(kind) == 1
            parse_version(payload)
        except DeviceError:
            continue


TCP = [0.0, 0.0, 0.28, 0.0, 0.0, 0.0]
RESULTS = {"setTcp": True, "getTCPOffset": TCP, "setPayload": False, "isSteady": True}


class Interface:
    """A stand-in for ur-rtde's control interface that fails at random."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*_: object) -> Any:
            if error := self._rng.choice((None, None, RuntimeError, ValueError, TypeError, IndexError)):
                raise error("the text of the library")
            return RESULTS[name]

        return call


CALLS = (
    (ControlCommands.set_tcp, ([0.0] * 6,), [True, TCP]),
    (ControlCommands.set_payload, (1.2, [0.0] * 3), False),
    (ControlCommands.is_steady, (), True),
)


def raised(error: Exception) -> None:
    raise error


@pytest.mark.fuzz
def test_every_call_gets_its_own_answer_or_an_error(cases: Cases) -> None:
    """For any exception of the library and any split of the line, a call gets its own answer or an error."""
    rng = random.Random(6)
    interface, state = Interface(rng), SharedState()
    clock = SystemClock()
    heartbeat = Heartbeat(interface, state, Program(os.getppid()), clock)
    commands = ControlCommands(interface, heartbeat, clock)
    here, there = socket.socketpair()
    client = ControlClient(here, SimpleNamespace(name="it"), SystemClock())  # type: ignore[arg-type]
    asked = there.makefile("rb")
    failed, count = 0, cases(5_000)
    for number in range(1, count + 1):
        method, arguments, expected = rng.choice(CALLS)
        request = {"number": number, "call": method.__name__, "arguments": arguments}
        answered = answer(commands, request)
        line = json.dumps(answered).encode()
        for part in (line[: (cut := rng.randrange(len(line)))], line[cut:] + b"\n"):
            there.sendall(part)
        if "error" in answered:
            failed += 1
            with pytest.raises(DeviceError, match="the text of the library"):
                client.ask(method, *arguments)
        else:
            assert client.ask(method, *arguments) == expected
        assert json.loads(asked.readline()) == json.loads(json.dumps(request))
    assert 0 < failed < count
    for opened in (here, there, state):
        opened.close()


def test_late_answer_to_an_interrupted_call_is_not_given_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = socket.socketpair()
    client = ControlClient(here, SimpleNamespace(name="it"), SystemClock())  # type: ignore[arg-type]
    monkeypatch.setattr(client, "_take", lambda *_: raised(OperatorStopError("stopped")))
    with pytest.raises(OperatorStopError):
        client.ask(ControlCommands.is_steady)
    monkeypatch.undo()
    for number, value in ((1, True), (2, [7, False])):
        there.sendall(json.dumps({"number": number, "value": value}).encode() + b"\n")
    assert client.ask(ControlCommands.operation) == [7, False]
    here.close()
    there.close()
