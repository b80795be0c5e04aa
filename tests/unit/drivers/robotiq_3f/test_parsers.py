"""Random, truncated and broken bytes at every parser of the gripper's two sides: typed errors only."""

import random
from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException

from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.robotiq_3f.modbus import PRESETS, Link, StatusClient
from drivers.robotiq_3f.registers import unpack_status
from drivers.types import Pose
from fakes.wire.gripper.modbus_frames import (
    FramingError,
    Registers,
    answer,
    rtu_frame,
    rtu_requests,
    tcp_requests,
)
from fakes.wire.gripper.model import GripperModel
from fakes.world.world import BenchLayout, World

STATUS = bytes.fromhex("B9 EA 00 FF BC 00 00 C1 00 00 BD 00 00 89 00 00")
WRITE = bytes.fromhex("10 03 E8 00 03 06 09 00 00 FF FF FF")
LONGEST = 300


def broken(good: bytes, dice: random.Random) -> bytes:
    """A frame as a bad line delivers it: whole, cut, with changed or added bytes, or all noise."""
    kind = dice.randrange(5)
    if kind == 0:
        return dice.randbytes(dice.randrange(LONGEST))
    if kind == 1:
        return good[: dice.randrange(len(good))]
    if kind == 2:
        at = dice.randrange(len(good))
        return good[:at] + dice.randbytes(1) + good[at + 1 :]
    if kind == 3:
        return dice.randbytes(dice.randrange(20)) + good
    return good + dice.randbytes(dice.randrange(20))


def chunks(data: bytes, dice: random.Random) -> Iterator[bytes]:
    """The same bytes as they may arrive."""
    while data:
        size = dice.randrange(1, len(data) + 1)
        yield data[:size]
        data = data[size:]


@pytest.fixture(scope="module")
def registers() -> Registers:
    world = World(BenchLayout(base_T_table=Pose((0, 0, 0)), home=Pose((0, 0, 0.3))), seed=0)
    return Registers(GripperModel(world, 0, ("B", "C"), activation_s=3.0), "tcp-2014")


def test_any_bytes_may_reach_the_tcp_side(registers: Registers) -> None:
    dice = random.Random(1)
    good = bytes.fromhex("339A 0000 000D 02") + WRITE
    refused = answered = 0
    for _ in range(25_000):
        buffer = bytearray()
        try:
            for chunk in chunks(broken(good, dice), dice):
                buffer += chunk
                for request in tcp_requests(buffer):
                    reply = request.wrap(answer(request.pdu, registers))
                    assert len(reply) == 6 + int.from_bytes(reply[4:6], "big")
                    answered += 1
                assert len(buffer) <= LONGEST
        except FramingError:
            refused += 1
    assert refused > 1000
    assert answered > 1000


def test_any_bytes_may_reach_the_serial_side(registers: Registers) -> None:
    dice = random.Random(2)
    good = rtu_frame(9, WRITE)
    answered = 0
    for _ in range(25_000):
        buffer = bytearray()
        for chunk in chunks(broken(good, dice), dice):
            buffer += chunk
            for request in rtu_requests(buffer, unit=9):
                assert answer(request.pdu, registers)[0] & 0x7F == request.pdu[0]
                answered += 1
            assert len(buffer) <= LONGEST
    assert answered > 5000


def test_any_request_gets_an_answer(registers: Registers) -> None:
    dice = random.Random(3)
    for _ in range(15_000):
        pdu = bytes([dice.choice((3, 4, 6, 16, 23, dice.randrange(256)))]) + dice.randbytes(
            dice.randrange(40)
        )
        reply = answer(pdu, registers)
        assert reply[0] & 0x7F == pdu[0] & 0x7F
        assert len(reply) <= 253


def test_any_registers_are_unpacked_or_refused() -> None:
    dice = random.Random(4)
    for _ in range(20_000):
        values = [dice.randrange(0x10000) for _ in range(dice.choice((8, 8, 8, dice.randrange(20))))]
        if len(values) == 8:
            unpack_status(values)
        else:
            with pytest.raises(DeviceError, match="register image"):
                unpack_status(values)


class BabblingTcp(ModbusTcpClient):
    """A client whose server answers with a broken status, and is then gone."""

    dice = random.Random(5)

    def connect(self) -> bool:
        return True

    def send(self, request: bytes, addr: object = None) -> int:
        body = bytes([2, request[7]]) + bytes([len(STATUS)]) + STATUS
        reply = request[:2] + b"\0\0" + len(body).to_bytes(2, "big") + body
        self.coming = chunks(broken(reply, self.dice), self.dice)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        for chunk in self.coming:
            return chunk
        raise ConnectionException("gone")


class BabblingSerial(ModbusSerialClient):
    """The same on a serial line."""

    dice = random.Random(6)

    def connect(self) -> bool:
        return True

    def send(self, request: bytes, addr: object = None) -> int:
        reply = rtu_frame(9, bytes([request[1], len(STATUS)]) + STATUS)
        self.coming = chunks(broken(reply, self.dice), self.dice)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        for chunk in self.coming:
            return chunk
        raise ConnectionException("gone")


@pytest.mark.parametrize("preset", ["tcp", "rtu"])
def test_any_bytes_may_come_back_to_the_driver(preset: str) -> None:
    client = BabblingTcp("nowhere") if preset == "tcp" else BabblingSerial("nowhere")
    requests = StatusClient(Link("gripper", PRESETS[preset], lambda: client), SystemClock())
    read = refused = 0
    for number in range(12_000):
        try:
            if number % 4:
                unpack_status(requests.read_status())
                read += 1
            else:
                requests.write_command([0] * 8)
        except DeviceError:
            refused += 1
    assert read > 1000
    assert refused > 1000
