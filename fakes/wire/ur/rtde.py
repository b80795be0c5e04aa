"""The real-time data exchange, version 2, as the controller speaks it on port 30004, and its variables.

Packages are `uint16 size (of the whole), uint8 type, payload`, big-endian (Universal Robots, "Real-Time Data
Exchange (RTDE) Guide", also for the variables). One `RtdeSession` is one client's connection; it does not
read or write sockets. Outputs that the simulated controller does not model read zero. Every version of the
controller has all variables, also those that the guide introduces later.
"""

import math
import struct
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum

from drivers.errors import InputError

Value = float | int | tuple[float, ...] | tuple[int, ...]
Version = tuple[int, int, int, int]

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "INT32": "i",
    "UINT64": "Q",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
STRUCTS = {name: struct.Struct(">" + code) for name, code in FORMATS.items()}
REGISTERS = 48

_OUTPUTS = {
    "DOUBLE": "timestamp actual_execution_time target_execution_time speed_scaling target_speed_fraction "
    "actual_momentum actual_main_voltage actual_robot_voltage actual_robot_current "
    "actual_robot_energy_consumed actual_robot_braking_energy_dissipated standard_analog_input0 "
    "standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
    "euromap67_24V_voltage euromap67_24V_current tool_analog_input0 tool_analog_input1 "
    "tool_output_current tool_temperature tcp_force_scalar payload joint_position_deviation_ratio "
    "collision_detection_ratio",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd "
    "actual_current actual_current_window actual_current_as_torque joint_control_output "
    "actual_TCP_pose actual_TCP_speed actual_TCP_force actual_TCP_acceleration target_TCP_pose "
    "target_TCP_speed target_TCP_acceleration tcp_offset joint_temperatures actual_joint_voltage "
    "ft_raw_wrench wrench_calc_from_currents payload_inertia target_base_acceleration target_base_wrench",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog target_gravity",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage encoder0_raw encoder1_raw "
    "time_scale_source",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode "
    "tool_analog_input_types euromap67_input_bits euromap67_output_bits output_bit_registers0_to_31 "
    "output_bit_registers32_to_63 input_bit_registers0_to_31 input_bit_registers32_to_63 "
    "script_control_line",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits "
    "actual_configurable_digital_input_bits actual_configurable_digital_output_bits control_step",
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
}
_INPUTS = {
    "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
    "configurable_digital_output tool_digital_output_mask tool_digital_output "
    "standard_analog_output_mask standard_analog_output_type",
    "VECTOR6D": "external_force_torque",
}


def _table(groups: dict[str, str], direction: str) -> dict[str, str]:
    types = {name: kind for kind, names in groups.items() for name in names.split()}
    for kind, word in (("INT32", "int"), ("DOUBLE", "double")):
        types |= {f"{direction}_{word}_register_{i}": kind for i in range(REGISTERS)}
    return types | {f"{direction}_bit_register_{i}": "BOOL" for i in range(64, 128)}


INPUTS = _table(_INPUTS, "input")
OUTPUTS = _table(_OUTPUTS, "output") | {name: kind for name, kind in INPUTS.items() if "_register" in name}


class OutputBank:
    """The values that the controller publishes. They are encoded when they change, not when they are sent."""

    def __init__(self) -> None:
        self._values: dict[str, Value] = {}
        self._encoded: dict[str, bytes] = {}
        for name, kind in OUTPUTS.items():
            self.set(name, zero(kind))

    def set(self, name: str, value: Value) -> None:
        """Publish a value; vectors as tuples."""
        if self._values.get(name) == value:
            return
        packer = STRUCTS[OUTPUTS[name]]
        self._encoded[name] = packer.pack(*value) if isinstance(value, tuple) else packer.pack(value)
        self._values[name] = value

    def get(self, name: str) -> Value:
        return self._values[name]

    def pack(self, names: Iterable[str]) -> bytes:
        """Return the encoded values one after the other, as in a data package."""
        return b"".join([self._encoded[name] for name in names])


def zero(kind: str) -> Value:
    return _single(STRUCTS[kind].unpack(bytes(STRUCTS[kind].size)))


def _single(fields: tuple[float, ...]) -> Value:
    """Return a scalar as a number, a vector as a tuple."""
    return fields if len(fields) > 1 else next(iter(fields))


def unpack(names: Iterable[str], payload: bytes) -> dict[str, Value]:
    """Decode the named inputs from a data package, which may be shorter or longer than its recipe.

    ur-rtde 1.6.5 sends shorter (`setExternalForceTorque`) and longer (`getForwardKinematics`) ones. Raises
    `InputError` for an incomplete value.
    """
    values: dict[str, Value] = {}
    at = 0
    for name in names:
        if at == len(payload):
            break
        reader = STRUCTS[INPUTS[name]]
        if at + reader.size > len(payload):
            raise InputError(f"RTDE data package: '{name}' is cut after {len(payload) - at} bytes")
        values[name] = _single(reader.unpack_from(payload, at))
        at += reader.size
    return values


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
            PackageType.PROTOCOL_VERSION: lambda asked: bytes([asked == struct.pack(">H", PROTOCOL_VERSION)]),
            PackageType.CONTROLLER_VERSION: lambda _: struct.pack(">4I", *version),
            PackageType.SETUP_OUTPUTS: self._setup_outputs,
            PackageType.SETUP_INPUTS: self._setup_inputs,
            PackageType.START: lambda _: self._stream(bool(self._outputs), b""),
            PackageType.PAUSE: lambda _: self._stream(False, b"\x01"),
        }

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the client, return the bytes to answer. Raises `InputError` for invalid ones."""
        self._buffer += data
        return b"".join(self._answer(kind, payload) for kind, payload in split_packages(self._buffer))

    def due(self, cycle: int) -> bool:
        """Whether a data package is due in this control cycle."""
        return self.started and cycle % self._every == 0

    def data(self) -> bytes:
        return package(PackageType.DATA, b"\x01" + self._bank.pack(self._outputs))

    def _answer(self, kind: int, payload: bytes) -> bytes:
        reply, names = self._replies.get(kind), self._inputs.get(payload[0]) if payload else None
        if reply is not None:
            return package(kind, reply(payload))
        if kind == PackageType.DATA and names is not None:
            self._write(unpack(names, payload[1:]))
        else:
            self.ignored += 1
        return b""

    def _setup_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise InputError(f"RTDE output setup: {len(payload)} bytes, but the rate alone takes 8")
        (rate_hz,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        # unlike an input, an output is never in use by another client
        known = (None if self._refused(name) == "NOT_FOUND" else OUTPUTS.get(name) for name in names)
        kinds = [kind or "NOT_FOUND" for kind in known]
        found = bool(names) and "NOT_FOUND" not in kinds
        self._outputs, self._every = names if found else (), 1
        if rate_hz > 0.0:  # limited to 1 to 500 Hz; without a rate, all
            self._every = math.floor(CONTROL_HZ / min(max(rate_hz, LEAST_HZ), CONTROL_HZ))
        return bytes([found]) + ",".join(kinds).encode()

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

    def _stream(self, started: bool, answer: bytes) -> bytes:
        """Start or pause the data packages. answer: the reply; if empty, whether they were started."""
        self.started = started
        return answer or bytes([started])


def _names(payload: bytes) -> tuple[str, ...]:
    """Split comma-separated names; ur-rtde leaves a comma at the end."""
    text = payload.decode("ascii", errors="replace")
    return tuple(name for name in text.split(",") if name)
