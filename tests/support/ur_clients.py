"""The simulated controller at a separate address, and clients of it with plain sockets."""

import itertools
import os
import socket
import struct
from collections.abc import Callable

from fakes.clock import SimulatedClock
from fakes.wire.ur.controller import URController
from support.worlds import empty_world

_addresses = itertools.count(1)


Connect = Callable[..., "Client"]


def make(version: str = "5.11.0", host: str = "") -> URController:
    pid = os.getpid()
    host = host or f"127.{30 + pid % 60}.{pid // 60 % 250}.{next(_addresses)}"
    return URController(empty_world(), SimulatedClock(realtime=True), host, version)


class Client:
    """A client of the data exchange in plain sockets."""

    def __init__(self, host: str, names: str = "timestamp", rate_hz: float = 500.0) -> None:
        self.socket = socket.create_connection((host, 30004), timeout=120)
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

    def _read(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.socket.recv(count - len(data))
            if not part:
                raise EOFError
            data += part
        return data
