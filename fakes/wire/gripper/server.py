"""A 3-Finger gripper on the wire: a Modbus TCP server, and an RTU slave on a pseudo-terminal.

Both are usable by any Modbus client. Not modelled: baud rate, parity and modem lines of the serial line (a
wrong baud rate does not fail here), a limit on the number of TCP clients, several requests in one TCP segment
(only the first is answered).

Requests are decoded and answered by pymodbus's server. The driver uses the same library's client, so that an
error of its codec would cancel itself out: the tests therefore compare the frames with those printed in the
manuals, and use a client of another library.

`GripperModel` is the state machine behind the registers. Byte positions and bits are those of the Robotiq
3-Finger manual (sections "Robot output registers" and "Robot input registers"); nothing is shared with the
driver. Durations and the scissor positions of three modes are our assumptions, because the manual does not
give them. Automatic release and individual control of the scissor are not modelled.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import InputError
from fakes.faults import MOTIONLESS, Faults, overshot
from fakes.wire.net import Part
from fakes.world.motion import FingerPath
from fakes.world.world import FINGER_STIFFNESS_N_M, World

REFRESH_NS = 5_000_000
"""The registers are refreshed at 200 Hz: a status that is read sooner is still the one before."""
LATEST_NS = 2_000_000_000
"""Largest delay of a tick with which the fingers still stop where they met the object."""
IMAGE_BYTES = 16
RESET, ACTIVATING, CHANGING_MODE, READY = range(4)
SCISSOR_MODE = 3
AXES = ("A", "B", "C", "S")
OFFSETS: dict[str, int] = dict(zip(AXES, (3, 6, 9, 12), strict=True))
SCISSOR_OF_MODE = (0x89, 0xDC, 0x19, 0x19)
"""Scissor position of the modes basic (the manual's status example), pinch, wide and scissor (ours)."""
CLOSED_COUNTS = 255
MOVING_CURRENT = 0x0F
"""Current in the manual's example while the fingers close."""
MODE_CHANGE_S = 1.0
SLOWEST_M_S, FASTEST_M_S = 0.022, 0.110
WEAKEST_N, FORCE_PER_COUNT_N = 15.0, 0.175
MAJOR_FAULT = 0x0D


@dataclass(slots=True)
class FingerMotor:
    """One motor: its path, its request (position, speed, force), and its contact (gDT's 1 or 2, or 0)."""

    path: FingerPath
    asked: tuple[int, int, int] = (0, 0, 0)
    contact: int = 0

    def moving(self, now_ns: int) -> bool:
        return not self.path.profile.done_at(now_ns)

    def go(self, end: float, speed: float, now_ns: int) -> None:
        """Start towards `end`, in counts and counts per second."""
        self.path, self.contact = self.path.sent_to(end, speed, now_ns), 0

    def stop(self, now_ns: int) -> None:
        self.path = self.path.cut_at(now_ns)

    @property
    def closing(self) -> bool:
        return self.path.end > self.path.start


def mean_path(paths: list[FingerPath], now_ns: int) -> FingerPath:
    """Return one path for the opening between fingers, from now on.

    It is exact while the fingers move alike; otherwise it ends where they end, at their mean speed.
    """
    moving = [path for path in paths if not path.profile.done_at(now_ns)]
    here = sum(path.position_at(now_ns) for path in paths) / len(paths)
    end = sum(path.end if path in moving else path.position_at(now_ns) for path in paths) / len(paths)
    if not moving:
        return FingerPath.resting(here)
    longest = max(moving, key=lambda path: path.profile.duration_s).profile
    if longest.start_ns == now_ns:
        return FingerPath(here, end, longest)
    return FingerPath.resting(here).sent_to(end, longest.speed * len(moving) / len(paths), now_ns)


class GripperModel:
    """The device behind the registers. `tick` it every 5 ms; other calls only read or write bytes.

    fingers: the axes that carry the world's fingertips; the world's opening follows their mean. faults: names
    of the active faults: `deaf` ignores writes, the others are those of `fakes.faults.KINDS`.
    """

    def __init__(self, world: World, now_ns: int, fingers: tuple[str, ...], activation_s: float) -> None:
        self.written = bytearray(IMAGE_BYTES)
        self.faults: frozenset[str] = frozenset()
        self._world, self._fingers = world, fingers
        self._sweep_s = max(activation_s, 0.01) / 2
        self._open = float(world.layout.open_counts)
        scissor = float(SCISSOR_OF_MODE[0])
        starts = dict.fromkeys("ABC", world.fingers.position_at(now_ns)) | {"S": scissor}
        self.axes = {name: FingerMotor(FingerPath.resting(at)) for name, at in starts.items()}
        self._latched = bytes(IMAGE_BYTES)
        self._stage = RESET
        self._stage_ends_ns = 0
        self._swept = self._going = self._drifted = False
        self._mode = self._fault = 0
        self._ticked_ns = now_ns
        self.image = self._status(now_ns)

    def tick(self, now_ns: int) -> None:
        """Read the command registers, move, and refresh the status image."""
        before = [self.axes[name].path for name in self._fingers]
        for missed_ns in range(max(self._ticked_ns, now_ns - LATEST_NS) + REFRESH_NS, now_ns, REFRESH_NS):
            self._stop_at_contact(missed_ns)
        self._ticked_ns = now_ns
        request = self._latched if "deaf" in self.faults else bytes(self.written)
        self._take(request, now_ns)
        self._latched = request
        self._advance(now_ns)
        if "drift" in self.faults and not self._drifted:
            for name in self._fingers:
                axis = self.axes[name]
                axis.path, axis.contact = axis.path.drifting(self._open, now_ns), 0
        self._drifted = "drift" in self.faults
        self._stop_at_contact(now_ns)
        paths = [self.axes[name].path for name in self._fingers]
        if paths != before:
            self._world.fingers = mean_path(paths, now_ns)
        self.image = self._status(now_ns)

    def fail(self, code: int, now_ns: int) -> None:
        """Raise a fault; from 0x0D on the gripper stops and needs a reset and an activation."""
        self._fault = code
        if code >= MAJOR_FAULT:
            self._stage, self._going = RESET, False
            self._stop(now_ns)

    def lose_power(self, now_ns: int) -> None:
        """Clear all registers; the fingers stay where they are."""
        self._latched = self.written[:] = bytes(IMAGE_BYTES)
        self._reset(now_ns)
        self.image = self._status(now_ns)

    def clear_fault(self) -> None:
        """End a fault that needs no reset."""
        if self._fault < MAJOR_FAULT:
            self._fault = 0

    def _take(self, request: bytes, now_ns: int) -> None:
        if not request[0] & 1:
            self._reset(now_ns)
            return
        if not self._latched[0] & 1:
            self._stage, self._swept = ACTIVATING, False
            self._stage_ends_ns = now_ns + to_ns(self._sweep_s)
            self._sweep(CLOSED_COUNTS, now_ns)
        if self._stage == READY and request[0] >> 1 & 3 != self._mode:
            self._stop(now_ns)
            self._stage, self._going, self._mode = CHANGING_MODE, False, request[0] >> 1 & 3
            self._stage_ends_ns = now_ns + to_ns(MODE_CHANGE_S)
            self._turn_scissor(now_ns)

    def _reset(self, now_ns: int) -> None:
        self._stop(now_ns)
        self._stage, self._going, self._fault = RESET, False, 0

    def _stop(self, now_ns: int) -> None:
        for axis in self.axes.values():
            axis.stop(now_ns)
            axis.contact = 0

    def _sweep(self, end: float, now_ns: int) -> None:
        speed = 1.5 * (CLOSED_COUNTS - self._open) / self._sweep_s
        for name in "ABC":
            self.axes[name].go(end, speed, now_ns)

    def _turn_scissor(self, now_ns: int) -> None:
        self.axes["S"].go(float(SCISSOR_OF_MODE[self._mode]), 300.0, now_ns)

    def _advance(self, now_ns: int) -> None:
        if self._stage == ACTIVATING and now_ns >= self._stage_ends_ns:
            self._go_on_activating(now_ns)
        elif self._stage == CHANGING_MODE and now_ns >= self._stage_ends_ns:
            self._stage = READY
            if self.axes["S"].contact:
                self.fail(0x0E, now_ns)
        if self._stage == READY:
            self._follow(now_ns)

    def _go_on_activating(self, now_ns: int) -> None:
        if "blocked" in self.faults:
            self.fail(MAJOR_FAULT, now_ns)
        elif not self._swept:
            self._swept = True
            self._stage_ends_ns = now_ns + to_ns(self._sweep_s)
            self._sweep(self._open, now_ns)
        elif not any(axis.moving(now_ns) for axis in self.axes.values()):
            self._stage, self._mode = READY, self._latched[0] >> 1 & 3
            self._turn_scissor(now_ns)

    def _follow(self, now_ns: int) -> None:
        go_to = bool(self._latched[0] & 8)
        if go_to:
            individual = self._latched[1] & 4
            for name in "S" if self._mode == SCISSOR_MODE else "ABC":
                offset = OFFSETS[name if individual and name != "S" else "A"]
                self._ask(self.axes[name], self._latched[offset : offset + 3], now_ns, rearm=not self._going)
        elif self._going:
            self._stop(now_ns)
        self._going = go_to

    def _ask(self, axis: FingerMotor, request: bytes, now_ns: int, rearm: bool) -> None:
        """Pass an axis its request: position, speed, force.

        An axis in contact stays there unless it is sent back, is pressed harder, or rGTO has been set again.
        """
        position, speed, force = asked = request[0], request[1], request[2]
        if asked == axis.asked and not rearm:
            return
        end = max(float(position), self._open)
        back = (end < axis.path.position_at(now_ns)) == axis.closing
        if self.faults & MOTIONLESS:
            axis.stop(now_ns)
        elif rearm or not axis.contact or back or force > axis.asked[2]:
            if "overshoot" in self.faults:
                end = overshot(axis.path.position_at(now_ns), end, self._open, CLOSED_COUNTS)
            metres = SLOWEST_M_S + speed / 255 * (FASTEST_M_S - SLOWEST_M_S)
            axis.go(end, metres / self._world.layout.opening_per_count_m, now_ns)
        axis.asked = asked

    def _stop_at_contact(self, now_ns: int) -> None:
        moving = [(name, axis) for name, axis in self.axes.items() if axis.moving(now_ns)]
        resistance = FINGER_STIFFNESS_N_M * self._world.squeeze_at(now_ns) if moving else 0.0
        for name, axis in moving:
            limit = WEAKEST_N + FORCE_PER_COUNT_N * axis.asked[2]
            if self.faults & MOTIONLESS:
                axis.stop(now_ns)
            elif "blocked" in self.faults or (name != "S" and axis.closing and resistance >= limit):
                axis.stop(now_ns)
                axis.contact = 2 if axis.closing else 1

    def _status(self, now_ns: int) -> bytes:
        moving = [self.axes[name].moving(now_ns) for name in AXES]
        image = bytearray(IMAGE_BYTES)
        image[0] = self._latched[0] & 7 | self._going << 3 | self._stage << 4
        if self._going and not any(moving):
            stopped = sum(self.axes[name].contact > 0 for name in "ABC")
            image[0] |= {0: 3, 3: 2}.get(stopped, 1) << 6
        image[2] = self._fault or self._refusal()
        for number, name in enumerate(AXES):
            axis, offset = self.axes[name], OFFSETS[name]
            if self._going and not moving[number]:
                image[1] |= (axis.contact or 3) << 2 * number
            image[offset] = self._latched[offset]
            image[offset + 1] = round(axis.path.position_at(now_ns))
            if "false_success" in self.faults and self._going:
                image[offset + 1] = max(axis.asked[0], round(self._open))
            image[offset + 2] = MOVING_CURRENT if moving[number] else 0
        return bytes(image)

    def _refusal(self) -> int:
        """Return the priority fault of a motion that has to wait: 5, 6 or 7, also if rACT comes with rGTO."""
        if self._latched[0] & 9 != 9:
            return 0x07 if self._latched[0] & 8 else 0
        return {ACTIVATING: 0x05, CHANGING_MODE: 0x06}.get(self._stage, 0)


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


class WireGripper(Part, ABC):
    """The gripper behind pymodbus's server: registers, 200 Hz refresh, faults, and its event loop.

    preset: of the registers' addresses, see `BASES`. fingers: the axes that carry the world's fingertips.
    activation_s: duration of the activation (our assumption). Line faults are injected by the server's hooks:
    `_access` refuses or delays a request, `_pdu` replaces a reply by an exception, `_packet` damages the
    bytes of a reply.
    """

    unit = 0
    """The unit that is answered, 0 for any."""

    def __init__(
        self,
        world: World,
        clock: Clock,
        preset: str,
        fingers: tuple[str, ...] = ("B", "C"),
        activation_s: float = 3.0,
    ) -> None:
        super().__init__("simulated gripper", lambda: asyncio.run(self._serve()))
        if preset not in BASES:
            raise InputError(f"simulated gripper: no preset '{preset}': use one of {', '.join(BASES)}")
        self._clock = clock
        self._model = GripperModel(world, clock.now_ns(), fingers, activation_s)
        self._command, self._status = BASES[preset]
        self._faults = Faults("simulated gripper", FAULTS, clock.now_ns)
        self._requests = self._replies = 0
        self._random = random.Random(0)  # noqa: S311 - noise on a line, not a secret
        self._opened: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._lock = threading.RLock()

    def start(self) -> None:
        """Open the line and serve it from a thread. Raises `InputError` if it is in use."""
        super().start()
        self._opened.result()

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

    async def _serve(self) -> None:
        try:
            await self._open()
        except InputError as error:
            self._opened.set_exception(error)
            return
        self._opened.set_result(None)
        is_open = True
        while not self.stopping.is_set():
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

    preset: "tcp" or "tcp-2014". Its port is free at the start, and kept over a disconnect. more: as for
    `WireGripper`.
    """

    def __init__(
        self, world: World, clock: Clock, host: str = "127.0.0.1", preset: str = "tcp", **more: Any
    ) -> None:
        super().__init__(world, clock, preset, **more)
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

    def __init__(self, world: World, clock: Clock, link_path: str | Path, **more: Any) -> None:
        super().__init__(world, clock, "rtu", **more)
        self._link = Path(link_path)
        self._ends: tuple[int, ...] = ()
        self._heard_ns = 0
        self.device = str(self._link)
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
