"""Every parser of the arm with random bytes, truncated or mixed packages: typed errors, never a hang."""

import contextlib
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
from drivers.ur5e.controller import parse_version, read_package, refuse_local_control, serial_number
from drivers.ur5e.heartbeat import Heartbeat, Program
from drivers.ur5e.link import ControlClient
from drivers.ur5e.processes import ControlCommands, Watchdog, answer
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
            serial_number(answered)
            _typed(lambda answered=answered: refuse_local_control(answered))


def _typed(call: Callable[[], object]) -> None:
    """Make a call succeed, or fail with one of the rig's errors."""
    with contextlib.suppress(DeviceError):
        call()


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
        data = rng.choice((good, good[: rng.randrange(19)], rng.randbytes(rng.randrange(30)), b"\x00\x03v"))
        try:
            kind, payload = read_package(delivered(data, rng))
            assert len(kind) == 1
            parse_version(payload)
        except DeviceError:
            continue


class Interface:
    """A stand-in for ur-rtde's control interface that fails at random."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    def _drawn(self, value: object) -> Any:
        if error := self._rng.choice((None, None, RuntimeError, ValueError, TypeError, IndexError)):
            raise error("the text of the library")
        return value

    def setTcp(self, pose: list[float]) -> bool:  # noqa: N802
        return self._drawn(True)

    def getTCPOffset(self) -> list[float]:  # noqa: N802
        return self._drawn([0.0, 0.0, 0.28, 0.0, 0.0, 0.0])

    def setPayload(self, mass_kg: float, cog_m: list[float]) -> bool:  # noqa: N802
        return self._drawn(False)

    def isSteady(self) -> bool:  # noqa: N802
        return self._drawn(True)


CALLS = (
    (ControlCommands.set_tcp, ([0.0] * 6,), [True, [0.0, 0.0, 0.28, 0.0, 0.0, 0.0]]),
    (ControlCommands.set_payload, (1.2, [0.0] * 3), False),
    (ControlCommands.is_steady, (), True),
)


@pytest.mark.fuzz
def test_every_call_gets_its_own_answer_or_an_error(cases: Cases) -> None:
    """For any exception of the library and any split of the line, a call gets its own answer or an error."""
    rng = random.Random(6)
    interface, state = Interface(rng), SharedState()
    clock = SystemClock()
    heartbeat = Heartbeat(interface, state, Program(os.getppid()), clock)
    commands = ControlCommands(interface, Watchdog(None, clock), heartbeat)
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


class Interrupted(SystemClock):
    """A clock that raises Ctrl-C while an answer is awaited."""

    def __init__(self) -> None:
        super().__init__()
        self.looks = 0

    def now_ns(self) -> int:
        self.looks += 1
        if self.looks == 2:
            raise OperatorStopError("stopped")
        return super().now_ns()


def test_late_answer_to_an_interrupted_call_is_not_given_to_the_next() -> None:
    here, there = socket.socketpair()
    client = ControlClient(here, SimpleNamespace(name="it"), Interrupted())  # type: ignore[arg-type]
    with pytest.raises(OperatorStopError):
        client.ask(ControlCommands.is_steady)
    for number, value in ((1, True), (2, [7, False])):
        there.sendall(json.dumps({"number": number, "value": value}).encode() + b"\n")
    assert client.ask(ControlCommands.operation) == [7, False]
    here.close()
    there.close()


@pytest.mark.parametrize("data", [b"", b"\x00", b"\xff" * 3, b"\xff\xff\x56"])
def test_package_with_an_impossible_size_is_rejected(data: bytes) -> None:
    with pytest.raises(DeviceError):
        read_package(delivered(data, random.Random(0)))
