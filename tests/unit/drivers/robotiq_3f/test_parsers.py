"""Every parser of the gripper's driver with random, truncated and corrupted bytes: typed errors only."""

import random
from collections.abc import Callable, Iterator

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException
from pymodbus.framer import FramerRTU

from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.robotiq_3f.modbus import PRESETS, Link, StatusClient
from drivers.robotiq_3f.registers import unpack_status

STATUS = bytes.fromhex("B9 EA 00 FF BC 00 00 C1 00 00 BD 00 00 89 00 00")


def broken(good: bytes, dice: random.Random) -> bytes:
    """A frame as a bad line delivers it: complete, truncated, with changed or added bytes, or random."""
    at, noise = dice.randrange(len(good)), dice.randbytes(dice.randrange(20))
    changed = good[:at] + dice.randbytes(1) + good[at + 1 :]
    return dice.choice((dice.randbytes(dice.randrange(300)), good[:at], changed, noise + good, good + noise))


def chunks(data: bytes, dice: random.Random) -> Iterator[bytes]:
    """The same bytes in any split."""
    while data:
        size = dice.randrange(1, len(data) + 1)
        yield data[:size]
        data = data[size:]


class Babbling:
    """A line whose gripper answers with a corrupted status and then closes the connection."""

    dice = random.Random(5)

    def connect(self) -> bool:
        return True

    def reply(self, request: bytes) -> bytes:
        raise NotImplementedError

    def send(self, request: bytes, addr: object = None) -> int:
        self.coming = chunks(broken(self.reply(request), self.dice), self.dice)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        for chunk in self.coming:
            return chunk
        raise ConnectionException("gone")


class BabblingTcp(Babbling, ModbusTcpClient):
    def reply(self, request: bytes) -> bytes:
        body = bytes([2, request[7], len(STATUS)]) + STATUS
        return request[:2] + b"\0\0" + len(body).to_bytes(2, "big") + body


class BabblingSerial(Babbling, ModbusSerialClient):
    def reply(self, request: bytes) -> bytes:
        body = bytes([9, request[1], len(STATUS)]) + STATUS
        return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


@pytest.mark.fuzz
@pytest.mark.parametrize("preset", ["tcp", "rtu"])
def test_any_bytes_from_the_gripper_are_parsed_or_rejected(preset: str, cases: Callable[[int], int]) -> None:
    client = BabblingTcp("nowhere") if preset == "tcp" else BabblingSerial("nowhere")
    requests = StatusClient(Link("gripper", PRESETS[preset], lambda timeout_s: client, 0.3), SystemClock())
    read, refused, count = 0, 0, cases(12_000)
    for number in range(count):
        try:
            if number % 4:
                unpack_status(requests.read_status())
                read += 1
            else:
                requests.write_command([0] * 8)
        except DeviceError:
            refused += 1
    assert read > count // 12
    assert refused > count // 12
