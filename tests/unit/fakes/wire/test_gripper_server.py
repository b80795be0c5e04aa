"""The gripper on the wire, asked by other Modbus clients and held to the frames of its manual."""

import os
import select
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymodbus.framer import FramerRTU

from drivers.clock import SystemClock
from fakes.wire.gripper.server import GripperRtu, GripperServer
from support.waiting import until
from support.worlds import empty_world

STATUS = "09 03 07 D0 00 08 45 C9"
"""RTU: read the whole status (2014 manual, steps 5 and 8)."""


@pytest.fixture
def server() -> Iterator[GripperServer]:
    server = GripperServer(empty_world(), SystemClock(), activation_s=0.1)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def line(tmp_path: Path) -> Iterator[GripperRtu]:
    line = GripperRtu(empty_world(), SystemClock(), tmp_path / "line", activation_s=1.0)
    line.start()
    yield line
    line.stop()


def exchange(stream: socket.socket, frame: str) -> str:
    """Send bytes as printed in the manual, return the reply likewise."""
    stream.sendall(bytes.fromhex(frame))
    return stream.recv(256).hex(" ").upper()


def talk(line: GripperRtu, frame: bytes, timeout_s: float = 1.0) -> bytes:
    """Send bytes down the serial line, return what comes within a while (nothing is an answer too)."""
    end = os.open(line.device, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(end, frame)
        if not select.select([end], [], [], timeout_s)[0]:
            return b""
        time.sleep(0.02)
        return os.read(end, 256)
    finally:
        os.close(end)


def talk_hex(line: GripperRtu, frame: str, timeout_s: float = 1.0) -> str:
    return talk(line, bytes.fromhex(frame), timeout_s).hex(" ").upper()


def replies_until(ask: Callable[[], str], beginning: str) -> list[str]:
    """All replies up to one that begins so; fails when none does."""
    replies: list[str] = []
    until(lambda: replies.append(ask()) or replies[-1].startswith(beginning), limit_s=120.0)
    return replies


@pytest.mark.parametrize(
    ("preset", "command", "status"), [("tcp", "00 00", "00 00"), ("tcp-2014", "03 E8", "07 D0")]
)
def test_tcp_frames_are_the_manuals(preset: str, command: str, status: str) -> None:
    """Activation, its progress, closing: manual 2018 pages 55 to 57, 2014 pages 78 to 82."""
    server = GripperServer(empty_world(), SystemClock(), preset=preset, activation_s=1.0)
    server.start()
    with socket.create_connection(server.address) as stream:
        activate = f"33 9A 00 00 00 0D 02 10 {command} 00 03 06 01 00 00 00 00 00"
        assert exchange(stream, activate) == f"33 9A 00 00 00 06 02 10 {command} 00 03"
        ask = f"45 33 00 00 00 06 02 04 {status} 00 01"
        seen = replies_until(lambda: exchange(stream, ask), "45 33 00 00 00 05 02 04 02 31 00")
        assert "45 33 00 00 00 05 02 04 02 11 00" in seen
        close = f"71 EE 00 00 00 0D 02 10 {command} 00 03 06 09 00 00 FF FF FF"
        assert exchange(stream, close) == f"71 EE 00 00 00 06 02 10 {command} 00 03"
        ask = f"77 6B 00 00 00 06 02 04 {status} 00 08"
        grip = replies_until(lambda: exchange(stream, ask), "77 6B 00 00 00 13 02 04 10 39 C0 00 FF")[-1]
        assert grip.endswith("0F 00 89 00 00"), "currents while closing, the scissor at 0x89"
    server.stop()


def test_status_registers_cannot_be_written() -> None:
    server = GripperServer(empty_world(), SystemClock(), preset="tcp-2014")
    server.start()
    with socket.create_connection(server.address) as stream:
        write = "33 9A 00 00 00 0D 02 10 07 D0 00 03 06 01 00 00 00 00 00"
        assert exchange(stream, write) == "33 9A 00 00 00 03 02 90 02"
    server.stop()


def test_another_master_over_tcp(server: GripperServer) -> None:
    """pyModbusTCP: reads, single and block writes, and both at once."""
    client_module = pytest.importorskip(
        "pyModbusTCP.client", reason="pip install pyModbusTCP: not installed here"
    )
    host, port = server.address
    client = client_module.ModbusClient(host, port, unit_id=9, timeout=120)
    assert client.read_input_registers(0, 8) == [0, 0, 0x0600, 0x0006, 0, 0x0600, 0x0089, 0]
    assert client.write_single_register(0, 0x0100)
    until(lambda: client.read_holding_registers(0, 1) == [0x3100])
    assert client.write_multiple_registers(0, [0x0900, 0x0030, 0xFFFF])
    until(lambda: client.read_input_registers(0, 2) == [0xF9FF, 0x0030])
    assert client.write_read_multiple_registers(0, [0x0900, 0x0000, 0xFFFF], 0, 2)
    until(lambda: client.read_input_registers(0, 3) == [0xF9FF, 0x0000, 0x0600])
    assert client.read_input_registers(7, 2) is None
    assert client.last_except == 2, "illegal data address"
    client.close()


def test_rtu_frames_are_the_manuals(line: GripperRtu) -> None:
    """Manual 2014, pages 66 to 74, with the CRCs printed there."""
    assert talk_hex(line, "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1") == "09 10 03 E8 00 03 01 30"
    ask = "09 03 07 D0 00 01 85 CF"
    assert "09 03 02 11 00 55 D5" in replies_until(lambda: talk_hex(line, ask), "09 03 02 31 00 4C 15")
    assert talk_hex(line, "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29") == "09 10 03 E8 00 03 01 30"
    replies_until(lambda: talk_hex(line, STATUS), "09 03 10 39 C0 00 FF")
    assert talk_hex(line, "09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19") == "09 10 03 E8 00 03 01 30"
    opened = replies_until(lambda: talk_hex(line, STATUS), "09 03 10 F9 FF 00 00")[-1]
    assert opened.startswith("09 03 10 F9 FF 00 00 06 00 00 06 00 00 06 00 00 89 00 00"), "open reads 6 or 7"


def test_serial_line_ignores_invalid_frames(line: GripperRtu) -> None:
    good = bytes.fromhex(STATUS)
    for frame in (good[:-1] + b"\0", b"\x08" + good[1:], bytes.fromhex("09 01 00 00 00 01 FC 82"), good[:4]):
        assert talk(line, frame, timeout_s=0.1) == b""
        time.sleep(0.06)

    def answered() -> bool:
        """Whether a frame after noise and a pause is answered; a loaded host may read both at once."""
        time.sleep(0.06)
        return talk(line, good)[:3] == b"\x09\x03\x10"

    until(answered)
    time.sleep(0.06)
    refused = bytes.fromhex("09 03 00 00 00 01")
    refused += FramerRTU.compute_CRC(refused).to_bytes(2, "big")
    assert talk(line, refused, timeout_s=0.1) == b"", "the 2014 manual has no exception replies"
