"""The variables of the real-time data exchange: names and types.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide", tables of controller outputs and inputs. Outputs
that the simulated controller does not model read zero. Every version of the controller has all variables,
also those that the guide introduces later.
"""

import struct
from collections.abc import Iterable

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

    def packed(self, names: Iterable[str]) -> bytes:
        """Return the encoded values one after the other, as in a data package."""
        return b"".join([self._encoded[name] for name in names])


def zero(kind: str) -> Value:
    return _single(STRUCTS[kind].unpack(bytes(STRUCTS[kind].size)))


def _single(fields: tuple[float, ...]) -> Value:
    """Return a scalar as a number, a vector as a tuple."""
    return fields if len(fields) > 1 else next(iter(fields))


def unpacked(names: Iterable[str], payload: bytes) -> dict[str, Value]:
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
