"""Modbus as a gripper's side speaks it: requests out of bytes, replies into bytes.

Written from the Modbus application protocol and serial line specifications, on its own: the
fakes share no codec with the drivers, so that an error cannot cancel itself out.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE_MANY, READ_WRITE = 3, 4, 6, 16, 23
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
MAX_PDU = 253


class Registers(Protocol):
    """What a request reads and writes. Both raise `LookupError` for addresses that do not exist."""

    def read(self, function: int, address: int, count: int) -> list[int]:
        """Return `count` registers from `address`."""
        ...

    def write(self, address: int, values: list[int]) -> None:
        """Set registers from `address`."""
        ...


class ModbusError(Exception):
    """A request that is answered with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class FramingError(Exception):
    """Bytes that cannot become a frame any more; the connection has to be dropped."""


@dataclass(frozen=True, slots=True)
class Request:
    """One request: for whom, its protocol data unit, and how to wrap the reply to it."""

    unit: int
    pdu: bytes
    wrap: Callable[[bytes], bytes]


def answer(pdu: bytes, registers: Registers) -> bytes:
    """Carry out one protocol data unit and return the reply's, an exception reply where it is refused."""
    function = pdu[0]
    try:
        return bytes([function]) + _carry_out(function, pdu[1:], registers)
    except ModbusError as error:
        code = error.code
    except LookupError:
        code = ILLEGAL_ADDRESS
    return bytes([function | 0x80, code])


def exception_reply(pdu: bytes, code: int) -> bytes:
    """Return the reply that refuses a request with an exception code."""
    return bytes([pdu[0] | 0x80, code])


def tcp_requests(buffer: bytearray) -> Iterator[Request]:
    """Take the complete requests out of a TCP stream's bytes; the rest stays in `buffer`.

    Raises `FramingError` when the bytes cannot be Modbus (protocol not 0, impossible length).
    """
    while len(buffer) >= 7:
        transaction, protocol, length, unit = struct.unpack_from(">HHHB", buffer)
        if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
            raise FramingError(f"no Modbus TCP header: {bytes(buffer[:7]).hex(' ')}")
        if len(buffer) < 6 + length:
            return
        pdu = bytes(buffer[7 : 6 + length])
        del buffer[: 6 + length]
        yield Request(unit, pdu, _tcp_wrapper(transaction, unit))


def rtu_requests(buffer: bytearray, unit: int) -> Iterator[Request]:
    """Take the complete requests to `unit` out of a serial line's bytes.

    Bytes with a wrong checksum are skipped one by one until a frame's is right: after noise the next
    good frame is found without having to time the pauses between frames.
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
        yield Request(unit, pdu, lambda reply: rtu_frame(unit, reply))


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    """Return a serial frame: unit, protocol data unit, CRC with its low byte first."""
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def crc16(data: bytes | bytearray) -> int:
    """CRC-16/MODBUS; over a whole good frame it is 0."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def _carry_out(function: int, body: bytes, registers: Registers) -> bytes:
    if function in (READ_HOLDING, READ_INPUT):
        address, count = _unpacked(">HH", body)
        return _values(_read(registers, function, address, count))
    if function == WRITE_ONE:
        address, value = _unpacked(">HH", body)
        registers.write(address, [value])
        return body
    if function == WRITE_MANY:
        address, count = _write_block(body, registers)
        return struct.pack(">HH", address, count)
    if function == READ_WRITE and len(body) > 4:
        address, count = _unpacked(">HH", body[:4])
        _write_block(body[4:], registers)
        return _values(_read(registers, READ_HOLDING, address, count))
    raise ModbusError(ILLEGAL_VALUE if function == READ_WRITE else ILLEGAL_FUNCTION)


def _read(registers: Registers, function: int, address: int, count: int) -> list[int]:
    if not 1 <= count <= 125:
        raise ModbusError(ILLEGAL_VALUE)
    return registers.read(function, address, count)


def _write_block(body: bytes, registers: Registers) -> tuple[int, int]:
    if len(body) < 5:
        raise ModbusError(ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", body)
    if not 1 <= count <= 123 or size != 2 * count or len(body) != 5 + size:
        raise ModbusError(ILLEGAL_VALUE)
    registers.write(address, list(struct.unpack(f">{count}H", body[5:])))
    return address, count


def _unpacked(layout: str, body: bytes) -> tuple[int, ...]:
    if len(body) != struct.calcsize(layout):
        raise ModbusError(ILLEGAL_VALUE)
    return struct.unpack(layout, body)


def _values(values: list[int]) -> bytes:
    return struct.pack(f">B{len(values)}H", 2 * len(values), *values)


def _tcp_wrapper(transaction: int, unit: int) -> Callable[[bytes], bytes]:
    return lambda pdu: struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def _rtu_length(buffer: bytearray) -> int | None:
    """Length of the serial frame that begins here, as far as it can be known; None when none does."""
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
