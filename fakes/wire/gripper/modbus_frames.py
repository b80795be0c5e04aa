"""Modbus on the side of the gripper: requests from bytes, replies to bytes, and the registers between them.

Written from the Modbus application protocol and serial line specifications: the fakes share no codec with the
drivers, so that an error cannot cancel itself out.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.errors import InputError
from fakes.wire.gripper.model import IMAGE_BYTES, GripperModel

BASES = {"rtu": (0x03E8, 0x07D0), "tcp": (0x0000, 0x0000), "tcp-2014": (0x03E8, 0x07D0)}
"""First command register and first status register, by edition of the manual."""
READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE_MANY, READ_WRITE = 3, 4, 6, 16, 23
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
MAX_PDU = 253


class Registers:
    """The two register images of the model at their addresses. Raises `LookupError` for other addresses."""

    def __init__(self, model: GripperModel, preset: str) -> None:
        if preset not in BASES:
            raise InputError(f"simulated gripper: no preset '{preset}': use one of {', '.join(BASES)}")
        self._model = model
        self._command, self._status = BASES[preset]

    def read(self, address: int, count: int) -> list[int]:
        """Return status registers, or the written command registers if they have addresses of their own."""
        overlapping = self._command == self._status
        if not overlapping and self._command <= address < self._command + IMAGE_BYTES // 2:
            image, start = bytes(self._model.written), address - self._command
        else:
            image, start = self._model.image, address - self._status
        _require_inside(start, count)
        return list(struct.unpack_from(f">{count}H", image, 2 * start))

    def write(self, address: int, values: list[int]) -> None:
        """Set command registers; the gripper reads them at its next refresh."""
        start = address - self._command
        _require_inside(start, len(values))
        struct.pack_into(f">{len(values)}H", self._model.written, 2 * start, *values)


class ModbusError(Exception):
    """A refused request: it is answered with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class FramingError(Exception):
    """Bytes with which no frame begins; the connection has to be dropped."""


@dataclass(frozen=True, slots=True)
class Request:
    """The protocol data unit of a request, and how to wrap that of the reply."""

    pdu: bytes
    wrap: Callable[[bytes], bytes]


def answer(pdu: bytes, registers: Registers) -> bytes:
    """Execute a protocol data unit and return that of the reply: an exception reply if it is refused."""
    try:
        return pdu[:1] + _execute(pdu[0], pdu[1:], registers)
    except ModbusError as error:
        return exception_reply(pdu, error.code)
    except LookupError:
        return exception_reply(pdu, ILLEGAL_ADDRESS)


def exception_reply(pdu: bytes, code: int) -> bytes:
    """Return the reply that refuses a request with an exception code."""
    return bytes([pdu[0] | 0x80, code])


def tcp_requests(buffer: bytearray) -> Iterator[Request]:
    """Take the complete requests from the bytes of a TCP stream; the rest stays in `buffer`.

    Raises `FramingError` if the bytes cannot be Modbus (protocol not 0, impossible length).
    """
    while len(buffer) >= 7:
        transaction, protocol, length, unit = struct.unpack_from(">HHHB", buffer)
        if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
            raise FramingError(f"no Modbus TCP header: {bytes(buffer[:7]).hex(' ')}")
        if len(buffer) < 6 + length:
            return
        pdu = bytes(buffer[7 : 6 + length])
        del buffer[: 6 + length]
        yield Request(pdu, _tcp_wrapper(transaction, unit))


def rtu_requests(buffer: bytearray, unit: int) -> Iterator[Request]:
    """Take the complete requests to `unit` from the bytes of a serial line.

    Bytes are skipped one by one until a frame has the right checksum: after noise the next valid frame is
    found without timing the pauses between frames.
    """
    while len(buffer) >= 4:
        length = _rtu_length(buffer) if buffer[0] == unit else None
        if length is not None and len(buffer) < length:
            return
        if length is None or crc16(buffer[:length]) != 0:
            del buffer[0]
            continue
        pdu = bytes(buffer[1 : length - 2])
        del buffer[:length]
        yield Request(pdu, lambda reply: rtu_frame(unit, reply))


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    """Return a serial frame: unit, protocol data unit, CRC with its low byte first."""
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def crc16(data: bytes | bytearray) -> int:
    """Return the CRC-16/MODBUS; over a whole valid frame it is 0."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def _execute(function: int, body: bytes, registers: Registers) -> bytes:
    if function in (READ_HOLDING, READ_INPUT):
        return _read(body, registers)
    if function == WRITE_ONE:
        address, value = _two(body)
        registers.write(address, [value])
        return body
    if function == WRITE_MANY:
        _write_block(body, registers)
        return body[:4]
    if function == READ_WRITE:
        _write_block(body[4:], registers)
        return _read(body[:4], registers)
    raise ModbusError(ILLEGAL_FUNCTION)


def _read(body: bytes, registers: Registers) -> bytes:
    address, count = _two(body)
    if not 1 <= count <= 125:
        raise ModbusError(ILLEGAL_VALUE)
    return struct.pack(f">B{count}H", 2 * count, *registers.read(address, count))


def _write_block(body: bytes, registers: Registers) -> None:
    if len(body) < 5:
        raise ModbusError(ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", body)
    if not 1 <= count <= 123 or size != 2 * count or len(body) != 5 + size:
        raise ModbusError(ILLEGAL_VALUE)
    registers.write(address, list(struct.unpack(f">{count}H", body[5:])))


def _two(body: bytes) -> tuple[int, int]:
    if len(body) != 4:
        raise ModbusError(ILLEGAL_VALUE)
    return struct.unpack(">HH", body)


def _require_inside(start: int, count: int) -> None:
    if start < 0 or start + count > IMAGE_BYTES // 2:
        raise LookupError(f"registers {start} to {start + count - 1} of 0 to {IMAGE_BYTES // 2 - 1}")


def _tcp_wrapper(transaction: int, unit: int) -> Callable[[bytes], bytes]:
    return lambda pdu: struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def _rtu_length(buffer: bytearray) -> int | None:
    """Return the length of the serial frame that begins here, as far as it is known; None if none begins."""
    function = buffer[1]
    if function in (READ_HOLDING, READ_INPUT, WRITE_ONE):
        return 8
    counted_at = {WRITE_MANY: 6, READ_WRITE: 10}.get(function)
    if counted_at is None:
        return None
    if len(buffer) <= counted_at:
        return counted_at + 4
    size = buffer[counted_at]
    fits = size == 2 * int.from_bytes(buffer[counted_at - 2 : counted_at], "big")
    return counted_at + size + 3 if fits else None
