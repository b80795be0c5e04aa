"""The simulated controller's sockets: several clients, faults on request, clients that misbehave."""

import itertools
import os
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.clock import SimulatedClock
from fakes.wire.ur.controller import URController
from fakes.wire.ur.faults import KINDS
from fakes.world.world import BenchLayout, World

_addresses = itertools.count(1)
Connect = Callable[..., "Client"]


def make(version: str = "5.11.0") -> URController:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1)
    pid = os.getpid()
    host = f"127.{30 + pid % 60}.{pid // 60 % 250}.{next(_addresses)}"
    return URController(world, SimulatedClock(realtime=True), host=host, version=version)


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Makes clients that are closed at the end."""
    with ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(Client(*arguments))


@pytest.fixture
def controller() -> Iterator[URController]:
    controller = make()
    controller.start()
    yield controller
    controller.stop()


class Client:
    """A client of the data exchange in plain sockets."""

    def __init__(self, host: str, names: str = "timestamp", rate_hz: float = 500.0) -> None:
        self.socket = socket.create_connection((host, 30004), timeout=2.0)
        self.ask(b"V", b"\x00\x02")
        self.kinds = self.ask(b"O", struct.pack(">d", rate_hz) + names.encode())
        self.ask(b"S")

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def ask(self, kind: bytes, payload: bytes = b"") -> bytes:
        self.socket.sendall(struct.pack(">Hc", 3 + len(payload), kind) + payload)
        while (answer := self.package())[0] != kind:
            pass
        return answer[1]

    def package(self) -> tuple[bytes, bytes]:
        size, kind = struct.unpack(">Hc", self._read(3))
        return kind, self._read(size - 3)

    def timestamp(self) -> float:
        while (answer := self.package())[0] != b"U":
            pass
        return struct.unpack(">d", answer[1][1:9])[0]

    def read_on(self) -> None:
        """Read until something happens."""
        while True:
            self.timestamp()

    def _read(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.socket.recv(count - len(data))
            if not part:
                raise EOFError
            data += part
        return data


def ask_dashboard(host: str, request: bytes) -> bytes:
    with socket.create_connection((host, 29999), timeout=2.0) as connection:
        lines = connection.makefile("rb")
        assert lines.readline() == b"Connected: Universal Robots Dashboard Server\n"
        connection.sendall(request + b"\n")
        return lines.readline()


def until(met: Callable[[], bool], limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_time_stamps_are_control_cycles(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    stamps = [client.timestamp() for _ in range(100)]
    steps = {round((b - a) * 500, 6) for a, b in itertools.pairwise(stamps)}
    assert steps == {1.0}


def test_two_controllers_have_their_own_state(controller: URController) -> None:
    other = make("5.25.0")
    other.start()
    try:
        assert b"5.11.0" in ask_dashboard(controller.host, b"PolyscopeVersion")
        assert b"5.25.0" in ask_dashboard(other.host, b"PolyscopeVersion")
        other.inject("protective_stop")
        assert other.snapshot()["safety_mode"] == "PROTECTIVE_STOP"
        assert controller.snapshot()["safety_mode"] == "NORMAL"
    finally:
        other.stop()


def test_a_taken_port_is_named() -> None:
    first = make()
    first.start()
    second = make()
    second._listeners.host = first.host
    with pytest.raises(InputError, match=r"cannot listen.*own address"):
        second.start()
    first.stop()
    second.start()
    second.stop()


def test_it_can_be_started_again(controller: URController, connect: Connect) -> None:
    controller.stop()
    controller.stop()
    controller.start()
    assert connect(controller.host).timestamp() > 0.0


def test_a_frozen_stream_sends_nothing_and_comes_back(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    controller.inject("stream_frozen")
    client.socket.settimeout(0.3)
    with pytest.raises(TimeoutError):
        client.read_on()
    controller.inject("clear")
    client.timestamp()


def test_a_frozen_stream_can_repeat_itself(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    client.timestamp()
    controller.inject("stream_frozen", repeat=True)
    until(lambda: client.timestamp() == client.timestamp())
    assert len({client.timestamp() for _ in range(50)}) == 1


def test_a_fault_may_end_by_itself(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    controller.inject("stream_frozen", duration_s=0.2)
    until(lambda: not controller.faults.frozen)
    client.timestamp()


def test_dropped_connections_end_and_new_ones_are_taken(controller: URController, connect: Connect) -> None:
    client = connect(controller.host)
    controller.inject("socket_dropped")
    with pytest.raises((EOFError, ConnectionError)):
        client.read_on()
    assert connect(controller.host).timestamp() > 0.0


def test_a_silent_controller_takes_connections_and_no_commands(controller: URController) -> None:
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


def test_in_local_control_no_program_is_taken(controller: URController) -> None:
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
def test_a_fault_that_does_not_exist_is_refused(
    controller: URController, kind: str, arguments: dict[str, object]
) -> None:
    with pytest.raises(InputError, match="simulated controller"):
        controller.inject(kind, **arguments)


def test_all_faults_are_explained() -> None:
    assert all(KINDS.values())


def test_a_controller_that_fails_says_so(controller: URController, monkeypatch: pytest.MonkeyPatch) -> None:
    assert controller.failure is None
    monkeypatch.setattr(controller.robot, "cycle", lambda time_ns: 1 / 0)
    until(lambda: isinstance(controller.failure, ZeroDivisionError))


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
