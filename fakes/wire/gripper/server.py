"""A 3-Finger gripper on the wire: a Modbus TCP server, and an RTU slave on a pseudo-terminal.

Both are usable by any Modbus client. Not modelled: baud rate, parity and modem lines of the serial line (a
wrong baud rate does not fail here), a limit on the number of TCP clients, several requests in one TCP segment
(only the first is answered).
"""

import asyncio
import contextlib
import os
import pty
import tty
from pathlib import Path
from typing import Any

from pymodbus.server import ModbusSerialServer, ModbusTcpServer

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from fakes.wire.gripper.transport import WireGripper
from fakes.world.world import World

PAUSE_S = 0.05
"""A pause of this length on the serial line ends an incomplete frame."""


class GripperServer(WireGripper):
    """Modbus TCP; any unit is answered, because the manual and the ROS driver use different ones.

    preset: "tcp" or "tcp-2014". Its port is free at
    the start, and kept over a disconnect. fingers: the axes
    that carry the world's fingertips. activation_s: duration of the activation (our assumption).
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        host: str = "127.0.0.1",
        preset: str = "tcp",
        fingers: tuple[str, ...] = ("B", "C"),
        activation_s: float = 3.0,
    ) -> None:
        super().__init__(world, clock, preset, fingers, activation_s)
        self.address = host, 0
        """Host and port, known from `start` on."""
        self._server: ModbusTcpServer | None = None

    async def _open(self) -> None:
        host, port = self.address
        server = ModbusTcpServer(self._device(), address=self.address, **self._hooks())
        if not await server.listen():
            raise InputError(
                f"simulated gripper: cannot listen at {host}:{port}; stop what uses it or choose another port"
            )
        listener: Any = server.transport
        self.address = host, listener.sockets[0].getsockname()[1]
        self._server = server

    def _close(self) -> None:
        if self._server is not None:
            self._server.close()


class GripperRtu(WireGripper):
    """Modbus RTU, unit 9, on a pseudo-terminal that is published under `link_path`.

    It does not answer other units, frames with a wrong checksum, or requests that it refuses, as the 2014
    manual has no exception replies. The link stays the same when the line is cut and comes back.
    """

    unit = 9

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
        self._heard_ns = 0

    @property
    def device(self) -> str:
        """Path to open as a serial device, from `start` on."""
        return str(self._link)

    async def _open(self) -> None:
        if self._link.exists() and not self._link.is_symlink():
            raise InputError(f"simulated gripper: {self._link} is in the way; name a path that is free")
        # the client's end stays open here too: else the line hangs up whenever a client closes it
        self._ends = line, theirs = pty.openpty()
        for end in self._ends:
            tty.setraw(end)
        os.set_blocking(line, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(theirs))
        self._server = ModbusSerialServer(self._device(), **self._hooks()).callback_new_connection()
        self._server.connection_made(_Line(line))
        asyncio.get_running_loop().add_reader(line, self._receive, line)

    def _close(self) -> None:
        if self._ends:
            self._link.unlink(missing_ok=True)
            asyncio.get_running_loop().remove_reader(self._ends[0])
            self._server.close()
            for end in self._ends:
                os.close(end)
        self._ends = ()

    def _receive(self, line: int) -> None:
        now = self._clock.now_ns()
        if now - self._heard_ns > PAUSE_S * NS_PER_S:
            self._server.recv_buffer = b""
        self._heard_ns = now
        with contextlib.suppress(OSError):
            self._server.data_received(os.read(line, 4096))

    def _packet(self, sending: bool, packet: bytes) -> bytes:
        refusal = sending and packet[1] & 0x80 and not self._faults.get("exception")
        return b"" if refusal else super()._packet(sending, packet)


class _Line(asyncio.Transport):
    """The server's end of a pseudo-terminal; its owner closes it."""

    def __init__(self, line: int) -> None:
        super().__init__()
        self._line = line

    def write(self, data: Any) -> None:
        os.write(self._line, data)

    def close(self) -> None:
        """Leave the line open."""
