"""The thread that owns a gripper's Modbus connection: polls the status, reacts to it, and sends commands.

Only this module uses pymodbus, whose client must not be shared between threads. Whatever it raises or returns
for a silent or cut line, an exception reply or invalid data becomes one `DeviceError` within two attempts.
Other threads read the newest status or queue a command; none of them waits longer than `ANSWER_S`.
"""

import logging
import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

from drivers.clock import NS_PER_S, Clock, host_s, to_ns, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError
from drivers.robotiq_3f.registers import REFRESH_S, REGISTERS, Status, unpack_status

if TYPE_CHECKING:
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient
    from pymodbus.pdu import ModbusPDU

    ModbusClient = ModbusTcpClient | ModbusSerialClient

TCP_TIMEOUT_S, RTU_TIMEOUT_S = 0.3, 0.2
"""Time limit of one reply, which takes a few milliseconds. Two of them, and on RTU the settling time between
them, are shorter than the second within which a dead connection must be reported."""
# Without a handler pymodbus would print on stderr what our errors already report.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

READ_HOLDING, READ_INPUT, WRITE_MULTIPLE = 3, 4, 16
"""Modbus function codes (Modbus application protocol)."""


@dataclass(frozen=True, slots=True)
class Preset:
    """Addresses of one edition of the manual.

    `command` and `status` are first registers; `read` is the function code that reads the status.
    """

    command: int
    status: int
    unit: int
    read: int


PRESETS = {
    "rtu": Preset(0x03E8, 0x07D0, unit=9, read=READ_HOLDING),
    "tcp": Preset(0x0000, 0x0000, unit=2, read=READ_INPUT),
    "tcp-2014": Preset(0x03E8, 0x07D0, unit=2, read=READ_INPUT),
}


@dataclass(frozen=True, slots=True)
class Link:
    """How to reach a gripper; `name` is for messages.

    make_client: creates a client with a time limit of one reply, s, which is `timeout_s` on the gripper's
    clock. settle_s: pause after a failure. RTU replies do not state which request they answer, so a late
    reply must have passed before the next request. host: network address; None for a serial line.
    """

    name: str
    preset: Preset
    make_client: Callable[[float], "ModbusClient"]
    timeout_s: float
    settle_s: float = 0.0
    host: str | None = None


def tcp_link(host: str, port: int = 502, preset: str = "tcp") -> Link:
    """Reach a gripper over Modbus TCP; preset "tcp" (2018 manual) or "tcp-2014".

    A unit does not show which edition it follows: if the status cannot be read with one preset, try the
    other. Raises `InputError` for an unknown preset, and without the library.
    """
    _require("pymodbus")

    def make_client(timeout_s: float) -> "ModbusClient":
        from pymodbus.client import ModbusTcpClient

        return ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0)

    return Link(f"gripper at {host}:{port}", _preset(preset), make_client, TCP_TIMEOUT_S, host=host)


def rtu_link(device: str, preset: str = "rtu", baudrate: int = 115200) -> Link:
    """Reach a gripper over Modbus RTU, 8N1, on a serial device. Raises `InputError`."""
    _require("pymodbus")
    _require("serial")

    def make_client(timeout_s: float) -> "ModbusClient":
        from pymodbus.client import ModbusSerialClient

        return ModbusSerialClient(device, baudrate=baudrate, timeout=timeout_s, retries=0)

    return Link(f"gripper on {device}", _preset(preset), make_client, RTU_TIMEOUT_S, RTU_TIMEOUT_S)


def _require(library: str) -> None:
    if find_spec(library) is None:
        raise InputError(f'gripper: {library} is not installed: pip install "visuotactile-slip-rig[bench]"')


class StatusClient:
    """Reads the status and writes commands over one link. For one thread only.

    After any failure the connection is closed and reopened, so that a late or broken reply cannot be read as
    the next one.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link, self._clock = link, clock
        self._client: ModbusClient | None = None
        self._failed_ns: int | None = None
        self.failures = 0
        self.round_trips_s: deque[float] = deque(maxlen=1000)

    def read_status(self) -> Sequence[int]:
        """Return the 8 status registers. Raises `DeviceError`."""
        preset = self._link.preset

        def read(client: "ModbusClient") -> "ModbusPDU":
            holding = preset.read == READ_HOLDING
            function = client.read_holding_registers if holding else client.read_input_registers
            return function(preset.status, count=REGISTERS, device_id=preset.unit)

        registers = self._ask(read, preset.read).registers
        if len(registers) != REGISTERS:
            self._fail()
            raise DeviceError(
                f"{self._link.name}: {len(registers)} status registers came back instead of {REGISTERS}; "
                "check that no other client uses the line"
            )
        return registers

    def write_command(self, registers: Sequence[int]) -> None:
        """Write the 8 command registers. Raises `DeviceError`; the gripper may nevertheless have got them."""
        first, unit = self._link.preset.command, self._link.preset.unit
        self._ask(lambda client: client.write_registers(first, [*registers], device_id=unit), WRITE_MULTIPLE)

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        client, self._client = self._client, None
        if client is not None:
            with suppress(OSError):
                client.close()

    def _ask(self, ask: "Callable[[ModbusClient], ModbusPDU]", function: int) -> "ModbusPDU":
        """Send a request up to twice; only once if the connection had just failed, to limit the wait."""
        may_retry = self._failed_ns is None
        if self._failed_ns is not None:
            self._clock.sleep_until(self._failed_ns + to_ns(self._link.settle_s))
        try:
            reply = self._reply(ask, function)
        except DeviceError:
            self._fail()
            if may_retry:
                return self._ask(ask, function)
            raise
        self._failed_ns = None
        return reply

    def _reply(self, ask: "Callable[[ModbusClient], ModbusPDU]", function: int) -> "ModbusPDU":
        from pymodbus.exceptions import ModbusIOException

        name = self._link.name
        try:
            self._client = self._client or self._link.make_client(host_s(self._clock, self._link.timeout_s))
            if not self._client.connect():
                raise DeviceError(f"{name}: cannot be opened; check power, cable and address")
            started = self._clock.now_ns()
            reply = ask(self._client)
            self.round_trips_s.append((self._clock.now_ns() - started) / NS_PER_S)
        except DeviceError:
            raise
        except ModbusIOException as error:
            raise DeviceTimeoutError(
                f"{name}: no readable reply in time; check power, cable, unit and preset"
            ) from error
        except Exception as error:  # invalid data make pymodbus's decoders raise almost anything
            raise DeviceError(f"{name}: the line failed ({error}); check power and cable") from error
        if reply.isError():
            raise DeviceError(
                f"{name}: rejected the request with Modbus exception {reply.exception_code}; "
                "check preset (rtu, tcp, tcp-2014) and unit"
            )
        if reply.function_code != function:
            raise DeviceError(
                f"{name}: got a reply to function {reply.function_code} instead of {function}; "
                "check that no other client uses the line"
            )
        return reply

    def _fail(self) -> None:
        self.failures += 1
        self._failed_ns = self._clock.now_ns()
        self.close()


def _preset(name: str) -> Preset:
    if name not in PRESETS:
        raise InputError(f"gripper: no preset '{name}': use one of {', '.join(PRESETS)}")
    return PRESETS[name]


POLL_S = 0.01
"""Pause between two reads of the status, and between two checks of it by a waiting caller."""
REACT_S = 0.005
"""The same pause while a status may need a reaction: the gripper refreshes its registers as often."""
RETRY_S = 0.1
"""Pause between attempts on a dead connection."""
ANSWER_S = 0.9
"""Longest wait of any caller; a request and its retry have failed by then, however they fail."""

Registers = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class StatusSample:
    """A status and the time of its request, ns; the status is not older than that, however late its reply."""

    time_ns: int
    status: Status


class GripperLine:
    """One connection, usable by any thread from `open` to `close`. It cannot be reopened."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._name = link.name
        self._clock = clock
        self.requests = StatusClient(link, clock)
        self._jobs: queue.Queue[tuple[Registers, Future[None]]] = queue.Queue()
        self._news = threading.Condition()
        self._newest: StatusSample | None = None
        self._error: DeviceError | None = None
        self.react: Callable[[Status], Registers | None] | None = None
        """Called with each status in the thread of the connection; the command image that it returns is
        written at once. It is removed when a command is sent, and nothing that it returned is written after
        that command."""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._own, name=link.name, daemon=True)

    def open(self) -> StatusSample:
        """Open the connection and return a first status. Raises `DeviceError` with the connection closed."""
        self._thread.start()
        try:
            return self.sample()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection, within `ANSWER_S` even if it is dead."""
        self._closing.set()
        self._thread.join(host_s(self._clock, ANSWER_S))

    def send(self, registers: Registers) -> None:
        """Write a command image. Raises `DeviceError`; a command not sent in time is never sent later."""
        self._require_open()
        self.react = None
        done: Future[None] = Future()
        self._jobs.put((registers, done))
        try:
            done.result(host_s(self._clock, ANSWER_S))
        except (TimeoutError, CancelledError):
            done.cancel()
            raise DeviceTimeoutError(
                f"{self._name}: command not acknowledged within {ANSWER_S} s; check power and cable"
            ) from None

    def sample(self) -> StatusSample:
        """Return the newest status; wait for the first one. Raises `DeviceError`, also if it is too old."""
        self._require_open()
        with self._news:
            answer_s = host_s(self._clock, ANSWER_S)
            self._news.wait_for(lambda: self._error is not None or self._newest is not None, answer_s)
            if self._error is not None:
                raise type(self._error)(*self._error.args) from self._error
            if self._newest is None or self._clock.now_ns() > self._newest.time_ns + to_ns(ANSWER_S):
                raise DeviceTimeoutError(f"{self._name}: no status for {ANSWER_S} s; check power and cable")
            return self._newest

    def watch(self, what: str, reached: Callable[[Status], bool], timeout_s: float) -> None:
        """Wait until `reached` is true for a status requested at least one register refresh from now.

        what: name of the condition in the `DeviceTimeoutError` raised after `timeout_s`.
        """
        start = self._clock.now_ns()

        def is_reached() -> bool:
            sample = self.sample()
            return sample.time_ns >= start + to_ns(REFRESH_S) and reached(sample.status)

        if not wait_until(self._clock, is_reached, timeout_s, POLL_S):
            raise DeviceTimeoutError(
                f"{self._name}: {what} not reached within {timeout_s} s; "
                "check power and preset, then activate again"
            )

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise NotConnectedError(f"{self._name}: used after disconnect; connect the bench first")

    def _own(self) -> None:
        while not self._closing.is_set():
            self._carry_out_next()
            asked_ns, sample, failure = self._clock.now_ns(), self._newest, None
            try:
                sample = StatusSample(asked_ns, unpack_status(self.requests.read_status()))
                react = self.react
                registers = None if react is None else react(sample.status)
                if registers is not None and self.react is react:
                    self.requests.write_command(registers)
            except DeviceError as error:
                failure = error
            with self._news:
                self._newest, self._error = sample, failure
                self._news.notify_all()
        self.requests.close()

    def _carry_out_next(self) -> None:
        try:
            pause_s = RETRY_S if self._error else POLL_S if self.react is None else REACT_S
            registers, done = self._jobs.get(timeout=host_s(self._clock, pause_s))
        except queue.Empty:
            return
        if self._closing.is_set() or not done.set_running_or_notify_cancel():
            return
        try:
            self.requests.write_command(registers)
        except DeviceError as error:
            done.set_exception(error)
        else:
            done.set_result(None)
