"""The controller's connections: reading and writing sockets without ever waiting for a client."""

import contextlib
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.errors import InputError

GIVE_UP_S = 10.0
"""A client that does not read is dropped after about this time (users' reports)."""
RECEIVE_BYTES = SEND_BYTES = 65536
MOST_PENDING = 1 << 20
"""A client that leaves more bytes of answers unread than this is dropped."""
MOST_CLIENTS = 100
"""Simultaneous connections; all fakes of a process share a thousand file descriptors."""
Feed = Callable[[bytes], bytes]


@dataclass(slots=True, eq=False)
class Connection:
    """One client. feed: returns the answer to received bytes, raises `InputError` for invalid ones."""

    socket: socket.socket
    port: int
    feed: Feed
    pending: bytes = b""
    blocked_ns: int | None = None
    last: bytes = b""
    closed: bool = False

    @property
    def behind(self) -> bool:
        return bool(self.pending)

    def receive(self) -> bytes | None:
        """Return the received bytes, None if the client is gone."""
        try:
            return self.socket.recv(RECEIVE_BYTES) or None
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            return None

    def send(self, data: bytes, time_ns: int, droppable: bool = False) -> None:
        """Send what the socket takes and keep the rest. While it is full, droppable data is discarded."""
        if self.behind and droppable:
            data = b""
        self.pending += data
        try:
            sent = self.socket.send(self.pending) if self.pending else 0
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError:
            self.closed = True
            return
        self.pending = self.pending[sent:]
        if not self.pending:
            self.blocked_ns = None
        elif self.blocked_ns is None or sent:
            self.blocked_ns = time_ns
        elif time_ns - self.blocked_ns > GIVE_UP_S * 1e9:
            self.closed = True
        if len(self.pending) > MOST_PENDING:
            self.closed = True

    def hang_up(self) -> None:
        """Shut the connection down; the serving thread then closes it."""
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.closed = True
        self.socket.close()


def listen(host: str, ports: Iterable[int]) -> dict[int, socket.socket]:
    """Listen on all ports. Raises `InputError` if one is in use or the address is not of this computer."""
    listeners: dict[int, socket.socket] = {}
    for port in ports:
        try:
            listeners[port] = _listening(host, port)
        except OSError as error:
            for listener in listeners.values():
                listener.close()
            raise InputError(
                f"simulated controller: cannot listen on {host} port {port}: {error.strerror}; "
                "its ports are fixed: give each controller its own address (127.0.0.2) or stop the other"
            ) from error
    return listeners


def accept(listener: socket.socket) -> socket.socket | None:
    """Accept the next client, None if it has disconnected already."""
    try:
        client, _ = listener.accept()
    except OSError:
        return None
    client.setblocking(False)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    return client


def _listening(host: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(16)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener
