"""The real-time data exchange, version 2, as the controller speaks it on port 30004.

Packages are `uint16 size (of the whole), uint8 type, payload`, big-endian (Universal Robots,
RTDE Guide). One `RtdeSession` is one client's connection; it does not read or write sockets.
"""

import math
import struct
from collections.abc import Callable, Iterator
from enum import IntEnum

from drivers.errors import InputError
from fakes.wire.ur.variables import INPUTS, OUTPUTS, OutputBank, Value, Version, unpacked

PROTOCOL_VERSION = 2
HEADER = struct.Struct(">HB")
CONTROL_HZ = 500
LEAST_HZ = 1
MAX_RECIPES = 255


class PackageType(IntEnum):
    """Types of packages; the values are ASCII letters."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


def package(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def split_packages(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Take the complete packages from the front of a buffer; an incomplete one stays there.

    Raises `InputError` for an impossible size, after which the stream cannot be followed any more.
    """
    while len(buffer) >= HEADER.size:
        size, kind = HEADER.unpack_from(buffer)
        if size < HEADER.size:
            raise InputError(
                f"RTDE package: size {size} is below the header's {HEADER.size}; close and connect"
            )
        if len(buffer) < size:
            return
        payload = bytes(buffer[HEADER.size : size])
        del buffer[:size]
        yield kind, payload


class RtdeSession:
    """The connection of one client: its recipes, whether it is started, and the answers to its requests.

    write: receives the inputs of each data package. refused: the fault with which a variable is refused,
    "IN_USE" or "NOT_FOUND", else None.
    """

    def __init__(
        self,
        bank: OutputBank,
        version: Version,
        write: Callable[[dict[str, Value]], None],
        refused: Callable[[str], str | None] = lambda _: None,
    ) -> None:
        self._bank, self._write, self._refused = bank, write, refused
        self._buffer = bytearray()
        self._inputs: dict[int, tuple[str, ...]] = {}
        self._outputs: tuple[str, ...] = ()
        self._every = 1
        self.started = False
        self.ignored = 0
        self._replies: dict[int, Callable[[bytes], bytes]] = {
            PackageType.PROTOCOL_VERSION: self._protocol,
            PackageType.CONTROLLER_VERSION: lambda _: struct.pack(">4I", *version),
            PackageType.SETUP_OUTPUTS: self._setup_outputs,
            PackageType.SETUP_INPUTS: self._setup_inputs,
            PackageType.START: lambda _: bytes([self._start()]),
            PackageType.PAUSE: lambda _: bytes([self._pause()]),
        }

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the client, return the bytes to answer. Raises `InputError` for invalid ones."""
        self._buffer += data
        return b"".join(self._answer(kind, payload) for kind, payload in split_packages(self._buffer))

    def due(self, cycle: int) -> bool:
        """Whether a data package is due in this control cycle."""
        return self.started and cycle % self._every == 0

    def data(self) -> bytes:
        return package(PackageType.DATA, b"\x01" + self._bank.packed(self._outputs))

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == PackageType.DATA:
            self._take(payload)
            return b""
        reply = self._replies.get(kind)
        if reply is None:
            self.ignored += 1
            return b""
        return package(kind, reply(payload))

    def _protocol(self, payload: bytes) -> bytes:
        return bytes([payload == struct.pack(">H", PROTOCOL_VERSION)])

    def _setup_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise InputError(f"RTDE output setup: {len(payload)} bytes, but the rate alone takes 8")
        (rate_hz,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        kinds = [self._output_kind(name) for name in names]
        found = bool(names) and "NOT_FOUND" not in kinds
        self._outputs = names if found else ()
        self._every = _cycles(rate_hz)
        return bytes([found]) + ",".join(kinds).encode()

    def _output_kind(self, name: str) -> str:
        """Return the type of an output. Unlike an input, it is never in use by another client."""
        return "NOT_FOUND" if self._refused(name) == "NOT_FOUND" else OUTPUTS.get(name, "NOT_FOUND")

    def _setup_inputs(self, payload: bytes) -> bytes:
        """Set up a recipe. Recipes are numbered from 1 in the order of the requests; 0 if it is refused."""
        names = _names(payload)
        kinds = [self._refused(name) or INPUTS.get(name, "NOT_FOUND") for name in names]
        number = len(self._inputs) + 1
        if not names or {"NOT_FOUND", "IN_USE"} & set(kinds) or number > MAX_RECIPES:
            number = 0
        else:
            self._inputs[number] = names
        return bytes([number]) + ",".join(kinds).encode()

    def _start(self) -> bool:
        self.started = bool(self._outputs)
        return self.started

    def _pause(self) -> bool:
        self.started = False
        return True

    def _take(self, payload: bytes) -> None:
        names = self._inputs.get(payload[0]) if payload else None
        if names is None:
            self.ignored += 1
            return
        self._write(unpacked(names, payload[1:]))


def _names(payload: bytes) -> tuple[str, ...]:
    """Split comma-separated names; ur-rtde leaves a comma at the end."""
    text = payload.decode("ascii", errors="replace")
    return tuple(name for name in text.split(",") if name)


def _cycles(rate_hz: float) -> int:
    """Return the control cycles between two packages at a rate, limited to 1 to 500 Hz; 1 without a rate."""
    if not rate_hz > 0.0:
        return 1
    return math.floor(CONTROL_HZ / min(max(rate_hz, LEAST_HZ), CONTROL_HZ))
