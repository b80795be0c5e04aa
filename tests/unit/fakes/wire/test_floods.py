"""Thousands of mutated packets on every port: the servers still answer, and memory stays flat.

RIG_FLOOD_PACKETS=100000 floods each port with so many; the suite takes fewer.
"""

import contextlib
import json
import os
import random
import select
import socket
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.clock import SystemClock
from drivers.types import Pose
from fakes.clock import SimulatedClock
from fakes.wire.gripper.modbus_frames import rtu_frame
from fakes.wire.gripper.server import GripperRtu, GripperServer
from fakes.wire.mjpeg.server import MjpegServer
from fakes.wire.net import Control, ControlServer
from fakes.wire.ur.controller import URController
from fakes.wire.ur.variables import INPUTS, OUTPUTS
from fakes.world.world import BenchLayout, World

PACKETS = int(os.environ.get("RIG_FLOOD_PACKETS", "1500"))
BATCH = 50
MOST_GROWTH_MB = 25.0
pytestmark = pytest.mark.timeout(120 + PACKETS / 50)
Make = Callable[[random.Random], bytes]
NUMBERS = ("0", "1", "-1", "0.3", "3.14159", "1e308", "-1e308", "1e999", "5e-324", "nan", "[]", "'x'")
DASHBOARD = (
    *("PolyscopeVersion", "robotmode", "safetymode", "running", "stop", "load a.urp", "power on"),
    *("brake release", "unlock protective stop", "popup hello", "get serial number", "quit", "shutdown"),
)


def make_world() -> World:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    return World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1)


@pytest.fixture
def controller() -> Iterator[URController]:
    host = f"127.{90 + os.getpid() % 50}.{os.getpid() // 50 % 250}.7"
    controller = URController(make_world(), SimulatedClock(realtime=True), host, "5.26.0")
    controller.start()
    yield controller
    controller.stop()


def mutated(rng: random.Random, packet: bytes) -> bytes:
    """A packet as it is, with a byte changed, cut, or none of what was there."""
    kind = rng.randrange(30)
    if kind == 0 and packet:
        at = rng.randrange(len(packet))
        return packet[:at] + bytes([rng.randrange(256)]) + packet[at + 1 :]
    if kind == 1:
        return packet[: rng.randrange(len(packet) + 1)]
    return rng.randbytes(rng.randrange(40)) if kind == 2 else packet


def rtde_packet(rng: random.Random) -> bytes:
    """A package of the data exchange."""
    names = rng.choices((*OUTPUTS, *INPUTS, "output_int_register_x", "", "\xff"), k=rng.randrange(6))
    listed = ",".join(names).encode("latin-1")
    rate = rng.choice((500.0, 125.0, 5e-324, -1.0, float("nan"), float("inf"), rng.uniform(0, 600)))
    payload = {
        "O": struct.pack(">d", rate) + listed,
        "U": bytes([rng.randrange(4)]) + rng.randbytes(rng.choice((0, 1, 4, 8, 48, 64))),
    }.get(kind := rng.choice("VvOOIIUUUUSPMZ"), listed if kind == "I" else rng.randbytes(rng.randrange(4)))
    return mutated(rng, struct.pack(">Hc", 3 + len(payload), kind.encode()) + payload)


def program(rng: random.Random) -> bytes:
    """A program of random lines."""

    def line() -> str:
        numbers = ", ".join(rng.choices(NUMBERS, k=rng.randrange(8)))
        return rng.choice(
            (f"movel(p[{numbers}], a=1, v=1)", f"sleep({numbers})", "end", f"if {numbers}:", numbers)
        )

    if rng.randrange(3) == 0:
        return mutated(rng, line().encode() + b"\n")
    body = "".join(f"  {line()}\n" for _ in range(rng.randrange(5)))
    return mutated(rng, f"def f():\n{body}end\n".encode())


def dashboard_line(rng: random.Random) -> bytes:
    return mutated(rng, rng.choice(DASHBOARD).encode() + b"\n")


def modbus_pdu(rng: random.Random) -> bytes:
    """A request to the gripper."""
    start, count = rng.choice((0, 1, 1000, 2000, 65535)), rng.choice((0, 1, 3, 8, 9, 125, 65535))
    body = rng.choice((struct.pack(">HH", start, count), rng.randbytes(rng.randrange(8))))
    return bytes([rng.choice((3, 4, 6, 16, 23, 1, 0, 0x90))]) + body + rng.randbytes(rng.choice((0, 0, 1, 7)))


def modbus_tcp(rng: random.Random) -> bytes:
    pdu = modbus_pdu(rng)
    return mutated(rng, struct.pack(">HHHB", rng.randrange(2**16), 0, len(pdu) + 1, rng.randrange(256)) + pdu)


def modbus_rtu(rng: random.Random) -> bytes:
    return mutated(rng, rtu_frame(rng.choice((9, 9, 8)), modbus_pdu(rng)))


def http_request(rng: random.Random) -> bytes:
    setting = rng.choice(("size_px", "rate_hz", "light", "kind"))
    value = rng.choice((1, -1, 1e400, [320, 240], [1, 1, 1], "freeze", None, {}))
    if rng.randrange(2):
        return mutated(rng, f"GET {rng.choice(('/', '/nothing'))} HTTP/1.1\r\n\r\n".encode())
    body = json.dumps({setting: value}).encode()
    head = f"POST {rng.choice(('/control', '/other'))} HTTP/1.1\r\nContent-Length: {len(body)}\r\n\r\n"
    return mutated(rng, head.encode() + body)


def side_channel_line(rng: random.Random) -> bytes:
    values = (None, 1, -1, 1e400, "arm", "silent", [], {}, "t1", 10**30)
    request = {"do": rng.choice(("fault", "status", "none", 3)), "kind": rng.choice(values)}
    request[rng.choice(("device", "duration_s", "repeat", "reply"))] = rng.choice(values)
    return mutated(rng, json.dumps(request).encode() + b"\n")


def flood(connect: Callable[[], socket.socket], make: Make) -> None:
    """Send packets in batches, each batch on a connection of its own; read what comes back."""
    rng, sent = random.Random(5), 0
    while sent < PACKETS:
        with contextlib.suppress(ConnectionError), connect() as connection:
            connection.settimeout(5.0)
            for _ in range(BATCH):
                connection.sendall(make(rng))
                sent += 1
                if select.select([connection], [], [], 0)[0] and not connection.recv(65536):
                    break


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextlib.contextmanager
def flat_memory(connect: Callable[[], socket.socket], make: Make) -> Iterator[None]:
    """Flood twice: what a server keeps it has after the first time."""
    flood(connect, make)
    before = resident_mb()
    flood(connect, make)
    grown = resident_mb() - before
    assert grown < MOST_GROWTH_MB, f"{grown:.1f} MB more after {PACKETS} further packets"
    yield


@pytest.mark.parametrize(
    ("port", "make"),
    [(30004, rtde_packet), (29999, dashboard_line), (30003, program)],
)
def test_the_controller(controller: URController, port: int, make: Make) -> None:
    with flat_memory(lambda: socket.create_connection((controller.host, port), timeout=5.0), make):
        assert controller.failure is None
        with socket.create_connection((controller.host, 29999), timeout=5.0) as connection:
            assert connection.makefile("rb").readline().startswith(b"Connected")
        with socket.create_connection((controller.host, 30004), timeout=5.0) as connection:
            connection.sendall(b"\x00\x03v")
            assert connection.recv(19)[2:3] == b"v"


def test_the_gripper_over_tcp() -> None:
    server = GripperServer(make_world(), SystemClock(), activation_s=0.1)
    server.start()
    with flat_memory(lambda: socket.create_connection(server.address, timeout=5.0), modbus_tcp):
        assert server.failure is None
        with socket.create_connection(server.address, timeout=5.0) as connection:
            connection.sendall(bytes.fromhex("0001 0000 0006 02 04 0000 0008"))
            assert connection.recv(64)[:9] == bytes.fromhex("0001 0000 0013 02 04 10")
    server.stop()


def test_the_gripper_on_the_serial_line(tmp_path: Path) -> None:
    line = GripperRtu(make_world(), SystemClock(), tmp_path / "line", activation_s=0.1)
    line.start()
    rng, end = random.Random(6), os.open(line.device, os.O_RDWR | os.O_NOCTTY)

    def send(count: int) -> None:
        for _ in range(count):
            os.write(end, modbus_rtu(rng))
            if select.select([end], [], [], 0)[0]:
                os.read(end, 4096)

    send(PACKETS)
    before = resident_mb()
    send(PACKETS)
    assert resident_mb() - before < MOST_GROWTH_MB
    answers = b""
    for _ in range(50):
        os.write(end, bytes.fromhex("09 03 07 D0 00 01 85 CF"))
        if select.select([end], [], [], 0.2)[0]:
            answers = os.read(end, 4096)
        if answers.startswith(b"\x09\x03\x02"):
            break
    assert answers.startswith(b"\x09\x03\x02")
    assert line.failure is None
    os.close(end)
    line.stop()


def test_a_stream_over_http() -> None:
    clock = SystemClock()
    server = MjpegServer("SIM-1", lambda _: np.zeros((320, 240, 3), np.uint8), 60.0, clock)
    server.start()
    host, _, port = server.url.removeprefix("http://").partition("/")[0].partition(":")
    with flat_memory(lambda: socket.create_connection((host, int(port)), timeout=5.0), http_request):
        assert server.failure is None
        with socket.create_connection((host, int(port)), timeout=5.0) as connection:
            connection.sendall(b"GET /stream.mjpg HTTP/1.1\r\n\r\n")
            assert b"200 OK" in connection.recv(4096)
    server.stop()


def test_the_side_channel(controller: URController) -> None:
    def fault(device: str, kind: str, **arguments: object) -> None:
        controller.inject(kind, **arguments)

    server = ControlServer({"fault": fault, "status": controller.snapshot})
    server.start()
    host, _, port = server.address.partition(":")
    with flat_memory(lambda: socket.create_connection((host, int(port)), timeout=5.0), side_channel_line):
        assert Control(server.address).call("status")["version"] == "5.26.0"
        assert controller.failure is None
    server.stop()
