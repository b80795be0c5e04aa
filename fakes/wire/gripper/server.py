"""A 3-Finger gripper on the wire: a Modbus TCP server, and an RTU slave on a pseudo-terminal.

Both are usable by any Modbus client. Not modelled: baud rate, parity and modem lines of the serial line (a
wrong baud rate does not fail here), a limit on the number of TCP clients.
"""

import contextlib
import os
import pty
import selectors
import socket
import tty
from functools import partial
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from fakes.wire.gripper import modbus_frames as frames
from fakes.wire.gripper.transport import WireGripper
from fakes.world.world import World

RTU_UNIT = 9
PAUSE_S = 0.05
"""A pause of this length on the serial line ends an incomplete frame."""
CHUNK = 4096


class GripperServer(WireGripper):
    """Modbus TCP; any unit is answered, because the manual and the ROS driver use different ones.

    preset: "tcp" or "tcp-2014". port: 0 takes a free one, which is kept over a disconnect. fingers: the axes
    that carry the world's fingertips. activation_s: duration of the activation (our assumption).
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
        self.address = host, port
        """Host and port, known from `start` on."""

    def _open(self) -> None:
        host, port = self.address
        try:
            listener = socket.create_server((host, port), reuse_port=False)
        except OSError as error:
            raise InputError(
                f"simulated gripper: cannot listen at {host}:{port} ({error.strerror}); "
                "stop what uses it or choose another port"
            ) from error
        listener.setblocking(False)
        self.address = host, listener.getsockname()[1]
        self._selector.register(listener, selectors.EVENT_READ)

    def _close(self) -> None:
        for key in list(self._selector.get_map().values()):
            self._drop(key.fileobj)

    def _receive(self, key: selectors.SelectorKey) -> None:
        connection: Any = key.fileobj
        if key.data is None:
            self._accept(connection)
            return
        try:
            data = connection.recv(CHUNK)
            if not data:
                raise ConnectionResetError
            key.data.extend(data)
            for request in frames.tcp_requests(key.data):
                self._handle(request, connection.sendall)
        except (OSError, frames.FramingError):
            self._drop(connection)

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            client, _ = listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._selector.register(client, selectors.EVENT_READ, bytearray())

    def _drop(self, connection: Any) -> None:
        self._selector.unregister(connection)
        connection.close()


class GripperRtu(WireGripper):
    """Modbus RTU, unit 9, on a pseudo-terminal that is published under `link_path`.

    It does not answer other units, frames with a wrong checksum, or requests that it refuses, as the 2014
    manual has no exception replies. The link stays the same when the line is cut and comes back.
    """

    refuses_silently = True

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
        self._ends: tuple[int, ...] = ()
        self._buffer = bytearray()
        self._heard_ns = 0

    @property
    def device(self) -> str:
        """Path to open as a serial device, from `start` on."""
        return str(self._link)

    def _open(self) -> None:
        if self._link.exists() and not self._link.is_symlink():
            raise InputError(f"simulated gripper: {self._link} is in the way; name a path that is free")
        # the client's end stays open here too: else the line hangs up whenever a client closes it
        self._ends = line, theirs = pty.openpty()
        for end in self._ends:
            tty.setraw(end)
        os.set_blocking(line, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(theirs))
        self._buffer.clear()
        self._selector.register(line, selectors.EVENT_READ)

    def _close(self) -> None:
        if self._ends:
            self._link.unlink(missing_ok=True)
            self._selector.unregister(self._ends[0])
            for end in self._ends:
                os.close(end)
        self._ends = ()

    def _receive(self, key: selectors.SelectorKey) -> None:
        now = self._clock.now_ns()
        if now - self._heard_ns > PAUSE_S * NS_PER_S:
            self._buffer.clear()
        self._heard_ns = now
        with contextlib.suppress(OSError):
            self._buffer += os.read(key.fd, CHUNK)
        for request in frames.rtu_requests(self._buffer, RTU_UNIT):
            self._handle(request, partial(self._write, key.fd))

    def _write(self, line: int, frame: bytes) -> None:
        """Send on the line on which the request came, unless it was cut since."""
        if line in self._ends:
            os.write(line, frame)
