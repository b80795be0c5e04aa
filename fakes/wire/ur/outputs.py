"""What the simulated controller publishes besides motion: inputs and outputs, and a healthy arm's figures."""

import math
from collections.abc import Callable
from typing import Protocol

from drivers.clock import NS_PER_S
from drivers.types import Vector6
from fakes.wire.ur import loads
from fakes.wire.ur.body import Body
from fakes.wire.ur.force import ForceSensor
from fakes.wire.ur.frames import to_ur
from fakes.wire.ur.safety import RobotMode, Safety
from fakes.wire.ur.variables import OutputBank, Value

_DIGITAL = (("standard", 0), ("configurable", 8), ("tool", 16))
JOINT_MODES = {
    RobotMode.POWER_OFF: 239,
    RobotMode.POWER_ON: 247,
    RobotMode.IDLE: 255,
    RobotMode.RUNNING: 253,
}
"""`joint_mode` of the RTDE guide: off, booting, idle, running."""
ROBOT_V, ROBOT_A = 48.0, 0.8
CYCLE_MS, BUSY_MS = 2.0, 0.5
NOT_RUNNING, NOT_SCALED = 0, 1
"""`time_scale_source` of the RTDE guide: no program runs; its speed is not scaled."""
LEAST_MA, SPAN_MA, SPAN_V = 4.0, 16.0, 10.0
"""An analog output's range as a current and as a voltage."""


class OutputSource(Protocol):
    """What the figures follow from: the robot."""

    bank: OutputBank
    body: Body
    safety: Safety
    force: ForceSensor
    time_ns: int

    @property
    def running(self) -> bool:
        """Whether a program runs."""
        ...

    @property
    def speed_scale(self) -> float:
        """Share of its speed at which a motion runs, 0 to 1."""
        ...


def publish_constants(bank: OutputBank) -> None:
    """Publish what does not change: voltages, temperatures and the like, of a warm arm at rest."""
    for name, value in {
        "target_speed_fraction": 1.0,
        "actual_execution_time": BUSY_MS,
        "target_execution_time": CYCLE_MS,
        "actual_main_voltage": ROBOT_V,
        "joint_temperatures": (29.0, 31.0, 31.0, 34.0, 35.0, 35.0),
        "actual_current_window": (8.0, 8.0, 8.0, 4.0, 4.0, 4.0),
        "io_current": 25.0,
        "standard_analog_output0": LEAST_MA,
        "standard_analog_output1": LEAST_MA,
        "tool_mode": JOINT_MODES[RobotMode.RUNNING],
        "tool_temperature": 35.0,
        "tool_digital_output0_mode": 1,
        "tool_digital_output1_mode": 1,
        "target_gravity": (0.0, 0.0, loads.GRAVITY_M_S2),
    }.items():
        bank.set(name, value)


def publish_on_demand(robot: OutputSource) -> None:
    """Publish what follows from the arm's state, worked out for those who ask for it."""
    body = robot.body
    figures: dict[str, Callable[[], Value]] = {
        "speed_scaling": lambda: robot.speed_scale,
        "time_scale_source": lambda: NOT_SCALED if robot.running else NOT_RUNNING,
        "control_step": lambda: robot.time_ns // round(CYCLE_MS * 1e6),
        "elbow_position": lambda: loads.elbow_position(body.q),
        "elbow_velocity": lambda: loads.elbow_velocity(body.q, body.qd),
        "actual_tool_accelerometer": lambda: loads.tool_acceleration(body.flange),
        "actual_momentum": lambda: math.hypot(*body.twist[:3]) * (loads.HAND_KG + body.payload_kg),
        "tcp_offset": lambda: to_ur(body.tool),
        "ft_raw_wrench": lambda: _raw_wrench(robot),
        "joint_mode": lambda: (JOINT_MODES[robot.safety.robot_mode],) * 6,
        "actual_joint_voltage": lambda: (_powered(robot, ROBOT_V),) * 6,
        "actual_robot_voltage": lambda: _powered(robot, ROBOT_V),
        "actual_robot_current": lambda: _powered(robot, ROBOT_A),
        "actual_robot_energy_consumed": lambda: ROBOT_V * ROBOT_A * robot.time_ns / NS_PER_S,
    }
    figures |= dict.fromkeys(("target_moment", "actual_current_as_torque"), lambda: _torques(body))
    figures |= dict.fromkeys(
        ("target_current", "actual_current", "joint_control_output"),
        lambda: loads.joint_currents(_torques(body)),
    )
    for name, work_out in figures.items():
        robot.bank.derive(name, work_out)


def _torques(body: Body) -> Vector6:
    return loads.joint_torques(body.q, body.flange, body.payload_kg, body.payload_cog_m)


def _raw_wrench(robot: OutputSource) -> Vector6:
    body = robot.body
    carried = loads.weight(body.flange, body.payload_kg, body.payload_cog_m)
    a, b, c, d, e, f = (v + w for v, w in zip(robot.force.unzeroed, carried, strict=True))
    return loads.in_flange_axes(body.flange, (a, b, c, d, e, f))


def _powered(robot: OutputSource, value: float) -> float:
    return value if robot.safety.robot_mode > RobotMode.POWER_OFF else 0.0


class IoBoard:
    """Digital and analog outputs and the speed slider, as clients set them."""

    def __init__(self, bank: OutputBank) -> None:
        self._bank = bank
        self._digital = 0
        self.speed_scale = 1.0

    def apply(self, written: dict[str, Value], inputs: dict[str, Value]) -> None:
        """Take a client's data package; the masks in it say which of all `inputs` count now."""
        for name, first in _DIGITAL:
            if mask := _whole(written, f"{name}_digital_output_mask"):
                self.set_digital(mask << first, _whole(inputs, f"{name}_digital_output") << first)
        if written.get("speed_slider_mask"):
            self._slide(_number(inputs, "speed_slider_fraction"))
        mask = _whole(written, "standard_analog_output_mask")
        for i in (0, 1):
            if mask >> i & 1:
                is_voltage = _whole(inputs, "standard_analog_output_type") >> i & 1
                self._set_analog(i, _number(inputs, f"standard_analog_output_{i}"), bool(is_voltage))

    def set_digital(self, mask: int, levels: int) -> None:
        """Set the masked digital outputs: standard 0 to 7, configurable 8 to 15, tool 16 and 17."""
        self._digital = self._digital & ~mask | levels & mask
        self._bank.set("actual_digital_output_bits", self._digital)
        self._bank.set("actual_configurable_digital_output_bits", self._digital >> 8 & 0xFF)

    def _set_analog(self, number: int, share: float, is_voltage: bool) -> None:
        """Set an analog output to a share of its range; published in V, or in mA."""
        value = share * SPAN_V if is_voltage else LEAST_MA + share * SPAN_MA
        self._bank.set(f"standard_analog_output{number}", value)
        types = _whole({"types": self._bank.get("analog_io_types")}, "types")
        self._bank.set("analog_io_types", types & ~(4 << number) | is_voltage << 2 + number)

    def _slide(self, fraction: float) -> None:
        self.speed_scale = max(0.0, min(1.0, fraction))
        self._bank.set("target_speed_fraction", self.speed_scale)


def _whole(values: dict[str, Value], name: str) -> int:
    return int(values.get(name, 0))  # type: ignore[arg-type]


def _number(values: dict[str, Value], name: str) -> float:
    return float(values[name])  # type: ignore[arg-type]
