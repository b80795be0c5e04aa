"""What the controller tells on ports 30001 to 30003 without being asked: its state, over and over.

Universal Robots, "Primary and Secondary Interfaces" and "Realtime Client Interface", as of 5.9 and
5.10. Left out are the packages that the guide keeps to UR's own software, and all messages but the
version's. What the guide does not say (order of packages, unit of time stamps) is as controllers send it.
"""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from fakes.wire.ur.body import MAX_JOINT_SPEED, Body
from fakes.wire.ur.kinematics import A2_M, A3_M, D1_M, D4_M, D5_M, D6_M
from fakes.wire.ur.safety import RobotMode, Safety, SafetyMode
from fakes.wire.ur.variables import OUTPUTS, OutputBank, Version

PRIMARY_CYCLES, REALTIME_CYCLES = 50, 1
"""Control cycles of 2 ms between two states: 10 Hz on ports 30001 and 30002, 500 Hz on 30003."""
ROBOT_STATE, ROBOT_MESSAGE, VERSION_MESSAGE = 16, 20, 3
_NO_TIME, _SOURCE = 2**64 - 1, -2
_PROJECT, _BUILT = b"URControl", b"30-06-2021, 12:00:00"
_US = 1000
_JOINT_LIMIT_RAD, _JOINT_ACCELERATION = 2.0 * math.pi, 40.0
_DEFAULTS = (math.radians(60.0), math.radians(80.0), 0.25, 1.2, 0.25)
"""Speed and acceleration of movej, of movel, and the radius that makes one of the other."""
_DH_A = (0.0, A2_M, A3_M, 0.0, 0.0, 0.0)
_DH_D = (D1_M, 0.0, 0.0, D4_M, D5_M, D6_M)
_DH_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
_DH_THETA = (0.0,) * 6
_NO_CHECKSUM = (0xFFFFFFFF,) * 6
_MASTERBOARD, _BOX, _UR5, _E_SERIES = 6, 4, 1, 3
_BOARD_C = 24.0
_BAUD, _STOP_BITS, _RX_IDLE, _TX_IDLE = 115200, 1, 1.5, 3.5

_REALTIME: tuple[str | int, ...] = (
    *("timestamp", "target_q", "target_qd", "target_qdd", "target_current", "target_moment"),
    *("actual_q", "actual_qd", "actual_current", "joint_control_output", "actual_TCP_pose"),
    *("actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed"),
    *("actual_digital_input_bits", "joint_temperatures", "actual_execution_time", 1, "robot_mode"),
    *("joint_mode", "safety_mode", 6, "actual_tool_accelerometer", 6, "speed_scaling", "actual_momentum", 2),
    *("actual_main_voltage", "actual_robot_voltage", "actual_robot_current", "actual_joint_voltage"),
    *("actual_digital_output_bits", "runtime_state", "elbow_position", "elbow_velocity"),
)
"""Names of the real-time data exchange, and how many numbers stand between that UR keeps to itself."""
_SINCE_5_4: tuple[str | int, ...] = ("safety_status",)
_SINCE_5_10: tuple[str | int, ...] = (3, "payload", "payload_cog", "payload_inertia")


_FLOATING = ("DOUBLE", "VECTOR3D", "VECTOR6D")


class StatePackage(IntEnum):
    """Parts of a robot state, in the order in which a controller sends them."""

    ROBOT_MODE = 0
    JOINTS = 1
    CARTESIAN = 4
    KINEMATICS = 5
    MASTERBOARD = 3
    TOOL = 2
    CONFIGURATION = 6
    FORCE_MODE = 7
    ADDITIONAL = 8
    TOOL_COMMUNICATION = 11
    TOOL_MODE = 12


class StateSource(Protocol):
    """What the states tell of: the robot."""

    bank: OutputBank
    body: Body
    safety: Safety
    version: Version
    time_ns: int

    @property
    def running(self) -> bool:
        """Whether a program runs."""
        ...

    @property
    def paused(self) -> bool:
        """Whether the program is paused."""
        ...


@dataclass(frozen=True, slots=True)
class StateStream:
    """A state that is sent once in so many control cycles."""

    cycles: int
    state: Callable[[], bytes]

    def due(self, cycle: int) -> bool:
        """Whether a state is due in this control cycle."""
        return cycle % self.cycles == 0

    def data(self) -> bytes:
        """The state of now."""
        return self.state()


def version_message(robot: StateSource) -> bytes:
    """What a client of port 30001 or 30002 gets first: the controller's version."""
    major, minor, bugfix, build = robot.version
    body = struct.pack(">QbBB", _NO_TIME, _SOURCE, VERSION_MESSAGE, len(_PROJECT)) + _PROJECT
    return _framed(ROBOT_MESSAGE, body + struct.pack(">BBii", major, minor, bugfix, build) + _BUILT)


def robot_state(robot: StateSource) -> bytes:
    """The state that ports 30001 and 30002 send."""
    return _framed(ROBOT_STATE, b"".join(_framed(kind, _PACKAGES[kind](robot)) for kind in StatePackage))


def realtime_state(robot: StateSource) -> bytes:
    """The state that port 30003 sends: 1108 bytes, 1116 since 5.4, 1220 since 5.10."""
    layout = _REALTIME
    for since, further in (((5, 4), _SINCE_5_4), ((5, 10), _SINCE_5_10)):
        layout += further if robot.version >= since else ()
    body = b"".join([_doubles(robot.bank, item) for item in layout])
    return struct.pack(">i", 4 + len(body)) + body


def _framed(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def _doubles(bank: OutputBank, item: str | int) -> bytes:
    """The value of a name as floating-point numbers, or so many zeros."""
    if isinstance(item, int):
        return bytes(8 * item)
    if OUTPUTS[item] in _FLOATING:
        return bank.packed((item,))
    values = _numbers(bank, item)
    return struct.pack(f">{len(values)}d", *values)


def _numbers(bank: OutputBank, name: str) -> tuple[float, ...]:
    value = bank.get(name)
    return value if isinstance(value, tuple) else (value,)


def _values(robot: StateSource, *names: str) -> Iterator[float]:
    for name in names:
        yield from _numbers(robot.bank, name)


def _whole(robot: StateSource, name: str) -> int:
    return int(_numbers(robot.bank, name)[0])


def _robot_mode(robot: StateSource) -> bytes:
    safety = robot.safety
    states = (
        *(True, True, safety.robot_mode > RobotMode.POWER_OFF),
        safety.mode is SafetyMode.ROBOT_EMERGENCY_STOP,
        safety.mode is SafetyMode.PROTECTIVE_STOP,
        *(robot.running, robot.running and robot.paused),
    )
    speeds = _values(robot, "target_speed_fraction", "speed_scaling")
    return struct.pack(">Q7?BB3dB", robot.time_ns // _US, *states, safety.robot_mode, 0, *speeds, 1.0, 0)


def _joints(robot: StateSource) -> bytes:
    names = ("actual_q", "target_q", "actual_qd", "actual_current", "actual_joint_voltage")
    columns = [_numbers(robot.bank, name) for name in (*names, "joint_temperatures")]
    modes = [int(mode) for mode in _numbers(robot.bank, "joint_mode")]
    rows = zip(*columns, (0.0,) * 6, modes, strict=True)
    return b"".join(struct.pack(">3d4fB", *row) for row in rows)


def _cartesian(robot: StateSource) -> bytes:
    return struct.pack(">12d", *_values(robot, "actual_TCP_pose", "tcp_offset"))


def _kinematics(_: StateSource) -> bytes:
    return struct.pack(">6I24dI", *_NO_CHECKSUM, *_DH_THETA, *_DH_A, *_DH_D, *_DH_ALPHA, 0)


def _masterboard(robot: StateSource) -> bytes:
    types = _whole(robot, "analog_io_types")
    outputs = [
        value if types >> 2 + i & 1 else value / 1000.0  # A
        for i, value in enumerate(_values(robot, "standard_analog_output0", "standard_analog_output1"))
    ]
    inputs = _values(robot, "standard_analog_input0", "standard_analog_input1")
    io_a = next(_values(robot, "io_current")) / 1000.0
    return struct.pack(
        ">iiBB2dBB2d4f3BI3B",
        *(_whole(robot, f"actual_digital_{way}_bits") for way in ("input", "output")),
        *(1, 1, *inputs, types >> 2 & 1, types >> 3 & 1, *outputs),
        *(_BOARD_C, *_values(robot, "actual_robot_voltage", "actual_robot_current"), io_a),
        *(robot.safety.mode, False, False, 0, 1, 1, 1),
    )


def _tool(robot: StateSource) -> bytes:
    inputs = _values(robot, "tool_analog_input0", "tool_analog_input1", "actual_robot_voltage")
    volts, mode = _whole(robot, "tool_output_voltage"), _whole(robot, "tool_mode")
    warmth = _values(robot, "tool_output_current", "tool_temperature")
    return struct.pack(">BB2dfB2fB", 1, 1, *inputs, volts, *warmth, mode)


def _configuration(_: StateSource) -> bytes:
    ranges = (-_JOINT_LIMIT_RAD, _JOINT_LIMIT_RAD) * 6
    motion = (MAX_JOINT_SPEED, _JOINT_ACCELERATION) * 6
    arm = (*_DH_A, *_DH_D, *_DH_ALPHA, *_DH_THETA)
    return struct.pack(">53d4i", *ranges, *motion, *_DEFAULTS, *arm, _MASTERBOARD, _BOX, _UR5, _E_SERIES)


def _force_mode(robot: StateSource) -> bytes:
    return struct.pack(">7d", *_values(robot, "actual_TCP_force"), dexterity(robot.body))


def dexterity(body: Body) -> float:
    """Squared determinant of the flange's Jacobian: 0 where the arm is singular."""
    _, q2, q3, q4, q5, _ = body.q
    reach = A2_M * math.cos(q2) + A3_M * math.cos(q2 + q3) + D5_M * math.sin(q2 + q3 + q4)
    return (A2_M * A3_M * math.sin(q3) * math.sin(q5) * reach) ** 2


def _tool_mode(robot: StateSource) -> bytes:
    names = ("tool_output_mode", "tool_digital_output0_mode", "tool_digital_output1_mode")
    return bytes(_whole(robot, name) for name in names)


_PACKAGES: dict[StatePackage, Callable[[StateSource], bytes]] = {
    StatePackage.ROBOT_MODE: _robot_mode,
    StatePackage.JOINTS: _joints,
    StatePackage.CARTESIAN: _cartesian,
    StatePackage.KINEMATICS: _kinematics,
    StatePackage.MASTERBOARD: _masterboard,
    StatePackage.TOOL: _tool,
    StatePackage.CONFIGURATION: _configuration,
    StatePackage.FORCE_MODE: _force_mode,
    StatePackage.ADDITIONAL: lambda _: bytes([False, True, False, False]),
    StatePackage.TOOL_COMMUNICATION: lambda _: struct.pack(
        ">?iii2f", False, _BAUD, 0, _STOP_BITS, _RX_IDLE, _TX_IDLE
    ),
    StatePackage.TOOL_MODE: _tool_mode,
}
