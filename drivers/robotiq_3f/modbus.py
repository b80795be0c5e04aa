"""Single Modbus requests to a Robotiq 3-Finger gripper: addresses, requests, and checks of the replies.

Only this module uses pymodbus. Whatever it raises or returns for a silent or cut line, an exception reply or
invalid data becomes one `DeviceError` within two attempts.
"""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, InputError
from drivers.robotiq_3f.registers import REGISTERS

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
    other. Raises `InputError` for an unknown preset.
    """

    def make_client(timeout_s: float) -> "ModbusClient":
        from pymodbus.client import ModbusTcpClient

        return ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0)

    return Link(f"gripper at {host}:{port}", _preset(preset), make_client, TCP_TIMEOUT_S, host=host)


def rtu_link(device: str, preset: str = "rtu", baudrate: int = 115200) -> Link:
    """Reach a gripper over Modbus RTU, 8N1, on a serial device. Raises `InputError`."""

    def make_client(timeout_s: float) -> "ModbusClient":
        from pymodbus.client import ModbusSerialClient

        return ModbusSerialClient(device, baudrate=baudrate, timeout=timeout_s, retries=0)

    return Link(f"gripper on {device}", _preset(preset), make_client, RTU_TIMEOUT_S, RTU_TIMEOUT_S)


class StatusClient:
    """Reads the status and writes commands over one link. For one thread only.

    After any failure the connection is closed and reopened, so that a late or broken reply cannot be read as
    the next one.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._client: ModbusClient | None = None
        self._failed_ns: int | None = None
        self.failures = 0
        self.round_trips_s: deque[float] = deque(maxlen=1000)

    def read_status(self) -> Sequence[int]:
        """Return the 8 status registers. Raises `DeviceError`."""
        preset = self._link.preset
        registers = self._retried(lambda client: _read(client, preset), preset.read).registers
        if len(registers) != REGISTERS:
            self._fail()
            raise DeviceError(
                f"{self._link.name}: {len(registers)} status registers came back instead of {REGISTERS}; "
                "check that no other client uses the line"
            )
        return registers

    def write_command(self, registers: Sequence[int]) -> None:
        """Write the 8 command registers. Raises `DeviceError`; the gripper may nevertheless have got them."""
        preset = self._link.preset
        values = list(registers)
        self._retried(
            lambda client: client.write_registers(preset.command, values, device_id=preset.unit),
            WRITE_MULTIPLE,
        )

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        client, self._client = self._client, None
        if client is not None:
            with suppress(OSError):
                client.close()

    def _retried(self, ask: "Callable[[ModbusClient], ModbusPDU]", function: int) -> "ModbusPDU":
        """Send a request up to twice; only once if the connection had just failed, to limit the wait."""
        if self._failed_ns is None:
            with suppress(DeviceError):
                return self._once(ask, function)
        return self._once(ask, function)

    def _once(self, ask: "Callable[[ModbusClient], ModbusPDU]", function: int) -> "ModbusPDU":
        if self._failed_ns is not None:
            self._clock.sleep_until(self._failed_ns + to_ns(self._link.settle_s))
        try:
            reply = self._reply(ask)
            self._check(reply, function)
        except DeviceError:
            self._fail()
            raise
        self._failed_ns = None
        return reply

    def _reply(self, ask: "Callable[[ModbusClient], ModbusPDU]") -> "ModbusPDU":
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
        return reply

    def _check(self, reply: "ModbusPDU", function: int) -> None:
        if reply.isError():
            raise DeviceError(
                f"{self._link.name}: rejected the request with Modbus exception {reply.exception_code}; "
                "check preset (rtu, tcp, tcp-2014) and unit"
            )
        if reply.function_code != function:
            raise DeviceError(
                f"{self._link.name}: got a reply to function {reply.function_code} instead of {function}; "
                "check that no other client uses the line"
            )

    def _fail(self) -> None:
        self.failures += 1
        self._failed_ns = self._clock.now_ns()
        self.close()


def _preset(name: str) -> Preset:
    if name not in PRESETS:
        raise InputError(f"gripper: no preset '{name}': use one of {', '.join(PRESETS)}")
    return PRESETS[name]


def _read(client: "ModbusClient", preset: Preset) -> "ModbusPDU":
    read = client.read_holding_registers if preset.read == READ_HOLDING else client.read_input_registers
    return read(preset.status, count=REGISTERS, device_id=preset.unit)
