"""A 3-Finger gripper on the wire: a Modbus TCP server, and an RTU slave on a pseudo-terminal.

Both are usable by any Modbus client. Not modelled: baud rate, parity and modem lines of the
serial line (a wrong baud rate does not fail here), a limit on the number of TCP clients.
"""

import contextlib
import os
import pty
import select
import selectors
import socket
import tty
from functools import partial
from pathlib import Path

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from fakes.wire.gripper import modbus_frames as frames
from fakes.wire.gripper.transport import WireGripper
from fakes.world.world import World

RTU_UNIT = 9
PAUSE_S = 0.05
"""A pause this long on the serial line ends whatever frame was begun."""
CHUNK = 4096


class GripperServer(WireGripper):
    """Modbus TCP; answers whatever unit is addressed, as the manual and the ROS driver differ on it.

    preset: "tcp" or "tcp-2014". port: 0 takes a free one, kept over a disconnect.
    fingers: the axes that carry the world's fingertips. activation_s: length of the sweep (ours).
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        host: str = "127.0.0.1",
        port: int = 0,
        preset: str = "tcp",
        fingers: tuple[str, ...] = ("B", "C"),
        activation_s: float = 3.0,
    ) -> None:
        super().__init__(world, clock, preset, fingers, activation_s)
        self._host, self._port = host, port
        self._listener: socket.socket | None = None
        self._selector = selectors.DefaultSelector()
        self._clients: dict[socket.socket, bytearray] = {}

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, from `start` on."""
        return self._host, self._port

    def _open(self) -> None:
        try:
            listener = socket.create_server((self._host, self._port), reuse_port=False)
        except OSError as error:
            raise InputError(
                f"simulated gripper: cannot listen at {self._host}:{self._port} ({error.strerror}); "
                "stop what uses it or choose another port"
            ) from error
        listener.setblocking(False)
        self._port = listener.getsockname()[1]
        self._selector.register(listener, selectors.EVENT_READ)
        self._listener = listener

    def _close(self) -> None:
        for client in list(self._clients):
            self._drop(client)
        listener, self._listener = self._listener, None
        if listener is not None:
            self._selector.unregister(listener)
            listener.close()

    @property
    def _is_open(self) -> bool:
        return self._listener is not None

    def _work(self, timeout_s: float) -> None:
        for key, _ in self._selector.select(timeout_s):
            if not isinstance(key.fileobj, socket.socket):
                continue
            if key.fileobj is self._listener:
                self._accept(key.fileobj)
            else:
                self._receive(key.fileobj)

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            client, _ = listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients[client] = bytearray()
            self._selector.register(client, selectors.EVENT_READ)

    def _receive(self, client: socket.socket) -> None:
        try:
            data = client.recv(CHUNK)
            if not data:
                raise ConnectionResetError
            self._clients[client] += data
            for request in frames.tcp_requests(self._clients[client]):
                self._handle(request, client.sendall)
        except (OSError, frames.FramingError):
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        if self._clients.pop(client, None) is not None:
            self._selector.unregister(client)
            client.close()


class GripperRtu(WireGripper):
    """Modbus RTU, unit 9, on a pseudo-terminal published under `link_path`.

    Silent to other units, to frames with a wrong checksum and to requests it refuses, as the
    2014 manual has no exception replies. The link stays the same when the line is cut and comes back.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        link_path: str | Path,
        fingers: tuple[str, ...] = ("B", "C"),
        activation_s: float = 3.0,
    ) -> None:
        super().__init__(world, clock, "rtu", fingers, activation_s)
        self._link = Path(link_path)
        self._ends: tuple[int, int] | None = None
        self._buffer = bytearray()
        self._heard_ns = 0

    @property
    def device(self) -> str:
        """Path to open as a serial device, from `start` on."""
        return str(self._link)

    def _open(self) -> None:
        if self._link.exists() and not self._link.is_symlink():
            raise InputError(f"simulated gripper: {self._link} is in the way; name a path that is free")
        ours, theirs = pty.openpty()
        for end in (ours, theirs):
            tty.setraw(end)
        os.set_blocking(ours, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(theirs))
        # Their end stays open here too: else the line hangs up whenever a client closes it.
        self._ends = ours, theirs
        self._buffer.clear()

    def _close(self) -> None:
        ends, self._ends = self._ends, None
        if ends is not None:
            self._link.unlink(missing_ok=True)
            for end in ends:
                os.close(end)

    @property
    def _is_open(self) -> bool:
        return self._ends is not None

    @property
    def _refuses_silently(self) -> bool:
        return True

    def _work(self, timeout_s: float) -> None:
        if self._ends is None:
            return
        line = self._ends[0]
        if not select.select([line], [], [], timeout_s)[0]:
            return
        now = self._clock.now_ns()
        if now - self._heard_ns > PAUSE_S * NS_PER_S:
            self._buffer.clear()
        self._heard_ns = now
        with contextlib.suppress(OSError):
            self._buffer += os.read(line, CHUNK)
        for request in frames.rtu_requests(self._buffer, RTU_UNIT):
            self._handle(request, partial(self._write, line))

    def _write(self, line: int, frame: bytes) -> None:
        """Send on the line it came from; after a cut that is gone."""
        if self._ends is not None and self._ends[0] == line:
            os.write(line, frame)
