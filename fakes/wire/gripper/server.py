"""A 3-Finger gripper on the wire: a Modbus TCP server, and an RTU slave on a pseudo-terminal.

Both are usable by any Modbus client. Not modelled: baud rate, parity and modem lines of the serial line (a
wrong baud rate does not fail here), a limit on the number of TCP clients, several requests in one TCP segment
(only the first is answered).

Requests are decoded and answered by pymodbus's server. The driver uses the same library's client, so that an
error of its codec would cancel itself out: the tests therefore compare the frames with those printed in the
manuals, and use a client of another library.
"""

import asyncio
import concurrent.futures
import contextlib
import logging
import os
import pty
import random
import struct
import threading
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import InputError
from fakes.faults import Faults
from fakes.wire.gripper.model import IMAGE_BYTES, REFRESH_NS, GripperModel
from fakes.wire.net import VitalThread
from fakes.world.world import World

FAULTS: dict[str, dict[str, Any]] = {
    "silent": {},
    "delay": {"delay_s": 0.35},
    "truncate": {"size": 4},
    "garbage": {"seed": 0},
    "exception": {"code": 4},
    "disconnect": {},
    "power_lost": {},
    "fault": {"code": 0x0D},
    "blocked": {},
    "stuck": {},
    "false_success": {},
    "overshoot": {},
    "drift": {},
    "deaf": {},
}
"""Kinds of fault and the defaults of their arguments."""
BASES = {"rtu": (0x03E8, 0x07D0), "tcp": (0x0000, 0x0000), "tcp-2014": (0x03E8, 0x07D0)}
"""First command register and first status register, by edition of the manual."""
REGISTERS = IMAGE_BYTES // 2
READS = (3, 4, 23)
"""Modbus functions whose reply contains registers that the gripper refreshes."""
WRITE_MANY = 16
Server = ModbusTcpServer | ModbusSerialServer
# Without a handler pymodbus would print refused requests on stderr.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class WireGripper(ABC):
    """The gripper behind pymodbus's server: registers, 200 Hz refresh, faults, and its event loop.

    Line faults are injected by the server's hooks: `_access` refuses or delays a request, `_pdu` replaces a
    reply by an exception, `_packet` damages the bytes of a reply.
    """

    unit = 0
    """The unit that is answered, 0 for any."""

    def __init__(
        self, world: World, clock: Clock, preset: str, fingers: tuple[str, ...], activation_s: float
    ) -> None:
        if preset not in BASES:
            raise InputError(f"simulated gripper: no preset '{preset}': use one of {', '.join(BASES)}")
        self._clock = clock
        self._model = GripperModel(world, clock.now_ns(), fingers, activation_s)
        self._command, self._status = BASES[preset]
        self._faults = Faults("simulated gripper", FAULTS, clock.now_ns)
        self._requests = self._replies = 0
        self._random = random.Random(0)  # noqa: S311 - noise on a line, not a secret
        self._stopping = threading.Event()
        self._thread: VitalThread | None = None
        self._lock = threading.RLock()

    def start(self) -> None:
        """Open the line and serve it from a thread. Raises `InputError` if it is in use."""
        self._stopping.clear()
        opened: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._thread = VitalThread(lambda: asyncio.run(self._serve(opened)), "simulated gripper")
        self._thread.start()
        opened.result()

    @property
    def failure(self) -> Exception | None:
        """The error that ended the gripper, None if there was none."""
        return self._thread.failure if self._thread else None

    def stop(self) -> None:
        """Stop serving. Safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def inject(self, kind: str, **arguments: Any) -> None:
        """Start a fault of `FAULTS`, or end all with "clear". Raises `InputError` for an unknown one."""
        with self._lock:
            settings, now_ns = self._faults.inject(kind, **arguments), self._clock.now_ns()
            match kind:
                case "clear":
                    self._model.clear_fault()
                case "fault":
                    self._model.fail(settings["code"], now_ns)
                case "power_lost":
                    self._model.lose_power(now_ns)
                case "garbage":
                    self._random.seed(settings["seed"])
            self._model.faults = self._faults.names()

    def snapshot(self) -> dict[str, Any]:
        """Return the counts of requests and replies, both register images in hex, and the active faults."""
        with self._lock:
            return {
                "requests": self._requests,
                "replies": self._replies,
                "written": self._model.written.hex(),
                "status": self._model.image.hex(),
                "faults": sorted(self._faults.names()),
            }

    @abstractmethod
    async def _open(self) -> None:
        """Open the line and serve it. Raises `InputError` if it is in use."""

    @abstractmethod
    def _close(self) -> None:
        """Close the line and all connections. Safe to call twice."""

    def _server_of(self, kind: type[Server], **arguments: Any) -> Any:
        """Return a server of pymodbus with the registers and the hooks."""
        firsts = sorted({self._command, self._status})
        blocks = [SimData(first, count=REGISTERS, datatype=DataType.REGISTERS) for first in firsts]
        device = SimDevice(self.unit, simdata=blocks, action=self._access)
        return kind(device, trace_pdu=self._pdu, trace_packet=self._packet, **arguments)

    async def _serve(self, opened: concurrent.futures.Future[None]) -> None:
        try:
            await self._open()
        except InputError as error:
            opened.set_exception(error)
            return
        opened.set_result(None)
        is_open = True
        while not self._stopping.is_set():
            with self._lock:
                now_ns = self._clock.now_ns()
                self._model.faults = active = self._faults.names()
                self._model.tick(now_ns)
            if "disconnect" in active and is_open:
                self._close()
                is_open = False
            elif "disconnect" not in active and not is_open:
                with contextlib.suppress(InputError):  # in use meanwhile: tried again at the next refresh
                    await self._open()
                    is_open = True
            due_ns = now_ns // REFRESH_NS * REFRESH_NS + REFRESH_NS
            await asyncio.sleep(host_s(self._clock, max(due_ns - self._clock.now_ns(), 0) / NS_PER_S))
        self._close()
        await asyncio.sleep(0)  # closed connections end in the next round of the loop

    async def _access(
        self,
        function: int,
        first: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Refresh the registers before a request reads them, or pass written ones to the model.

        first: address of `registers[0]`; values: the registers to write, None for a read.
        """
        with self._lock:
            if self._faults.names() & {"silent", "power_lost", "exception"}:
                return ExcCodes.DEVICE_FAILURE
            if values is not None:
                start = address - self._command
                if not 0 <= start <= REGISTERS - count:
                    return ExcCodes.ILLEGAL_ADDRESS
                struct.pack_into(f">{count}H", self._model.written, 2 * start, *values)
            elif function in READS:
                for base, image in ((self._command, self._model.written), (self._status, self._model.image)):
                    registers[base - first : base - first + REGISTERS] = struct.unpack(
                        f">{REGISTERS}H", image
                    )
        if (delay := self._faults.get("delay")) and (values is None or function == WRITE_MANY):
            due_ns = self._clock.now_ns() + to_ns(delay["delay_s"])
            while self._clock.now_ns() < due_ns:
                await asyncio.sleep(0.001)
        return None

    def _pdu(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        """Count requests, and replace replies by an exception during that fault."""
        if not sending:
            self._requests += 1
        elif fault := self._faults.get("exception"):
            return ExceptionResponse(pdu.function_code, fault["code"], pdu.dev_id, pdu.transaction_id)
        return pdu

    def _packet(self, sending: bool, packet: bytes) -> bytes:
        """Return the bytes of a reply as the line delivers them: none, other ones, or the first few."""
        if not sending:
            return packet
        if self._faults.names() & {"silent", "power_lost"}:
            return b""
        if self._faults.get("garbage"):
            packet = self._random.randbytes(len(packet))
        if truncate := self._faults.get("truncate"):
            packet = packet[: truncate["size"]]
        self._replies += 1
        return packet


PAUSE_S = 0.05
"""A pause of this length on the serial line ends an incomplete frame."""


class GripperServer(WireGripper):
    """Modbus TCP; any unit is answered, because the manual and the ROS driver use different ones.

    preset: "tcp" or "tcp-2014". Its port is free at the start, and kept over a disconnect. fingers: the
    axes that carry the world's fingertips. activation_s: duration of the activation (our assumption).
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
        server = self._server_of(ModbusTcpServer, address=self.address)
        if not await server.listen():
            raise InputError(
                f"simulated gripper: cannot listen at {host}:{port}; stop what uses it or choose another port"
            )
        self.address = host, server.transport.sockets[0].getsockname()[1]
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
        self.device = str(link_path)
        """Path to open as a serial device, from `start` on."""

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
        self._server = self._server_of(ModbusSerialServer).callback_new_connection()
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
