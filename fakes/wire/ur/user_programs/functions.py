"""What a user's program may call: motions, stops, sleep, TCP, payload, outputs, registers, geometry."""

import math
from collections.abc import Callable
from typing import Any

from drivers.types import Vector6
from fakes.wire.ur.body import ArmMover, JointMove, JointStop, LinearMove, LinearStop, SpeedMove
from fakes.wire.ur.control_loop import Thread
from fakes.wire.ur.frames import Frame, compose, from_ur, to_ur
from fakes.wire.ur.robot import CYCLE_S, Robot
from fakes.wire.ur.runtime import ProgramError

LONGEST_SLEEP_S = 3600.0


class PoseValue(tuple[float, ...]):
    """p[...]: a pose, as against a list of joint angles."""


def _joints(robot: Robot, target: tuple[float, ...]) -> Vector6:
    if isinstance(target, PoseValue):
        return robot.solved(_frame(target))
    a, b, c, d, e, f = target
    return robot.allowed((a, b, c, d, e, f))


def _frame(target: tuple[float, ...]) -> Frame:
    if len(target) != 6:
        raise ValueError(f"{len(target)} values instead of 6")
    return from_ur(target)


def _until(robot: Robot, mover: ArmMover) -> Thread:
    robot.body.mover = mover
    while robot.body.mover is mover:
        yield


def _move_j(
    robot: Robot, target: tuple[float, ...], a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0
) -> Thread:
    return _until(robot, JointMove(robot.body.q, _joints(robot, target), v, a))


def _move_l(
    robot: Robot, target: tuple[float, ...], a: float = 1.2, v: float = 0.25, t: float = 0, r: float = 0
) -> Thread:
    return _until(robot, LinearMove(robot.body.tcp, robot.tcp_at(_joints(robot, target)), v, a))


def _speed(joint: bool) -> Callable[..., Thread]:
    """A speed, kept for `t`, at least for a cycle, and on until something else comes (speedj, speedl)."""

    def keep(
        robot: Robot, velocity: tuple[float, ...], a: float = 0.5, t: float = 0, t_min: float = 0
    ) -> Thread:
        body, (x, y, z, rx, ry, rz), brake = robot.body, map(float, velocity), float(a)
        mover = body.mover
        if not isinstance(mover, SpeedMove) or mover.joint is not joint:
            body.mover = mover = SpeedMove(body.qd if joint else body.twist, joint)
        mover.target, mover.acceleration = (x, y, z, rx, ry, rz), brake
        yield from _sleep(robot, max(t, t_min, CYCLE_S))

    return keep


def _watchdog(robot: Robot, register: str, least_hz: float, action: str = "PAUSE") -> None:
    if register not in robot.inputs:
        raise ValueError(f"there is no input {register}")
    if action.upper() != "IGNORE":
        robot.watch(register, least_hz, pause=action.upper() == "PAUSE")


def _sleep(robot: Robot, duration_s: float) -> Thread:
    for _ in range(round(min(max(duration_s, 0.0), LONGEST_SLEEP_S) / CYCLE_S)):
        yield


def _sync(robot: Robot) -> Thread:
    yield


def _set_tcp(robot: Robot, pose: tuple[float, ...], *_: object) -> None:
    robot.set_tool(_frame(pose))


def _payload(robot: Robot, mass: float, cog: tuple[float, ...] | None = None, *_: object) -> None:
    robot.load(mass, cog)


def _halt(robot: Robot) -> None:
    raise ProgramError("halt")


def _output(first: int, count: int) -> Callable[[Robot, int, bool], None]:
    def switch(robot: Robot, number: int, level: bool) -> None:
        if number not in range(count):
            raise ValueError(f"there is no output {number}")
        robot.io.set_digital(1 << int(number) + first, bool(level) << int(number) + first)

    return switch


def _register(kind: str) -> Callable[[Robot, int, float], None]:
    return lambda robot, number, value: robot.bank.set(f"output_{kind}_register_{int(number)}", value)


def _ignored(robot: Robot, *_: object, **__: object) -> None:
    """Has an effect on the pendant only."""


ACTIONS: dict[str, Callable[..., Thread | None]] = {
    "movej": _move_j,
    "movel": _move_l,
    "movep": _move_l,
    "stopj": lambda robot, a=2.0: _until(robot, JointStop(robot.body.qd, a)),
    "stopl": lambda robot, a=2.0: _until(robot, LinearStop(robot.body.twist, a)),
    "speedl": _speed(joint=False),
    "speedj": _speed(joint=True),
    "sleep": _sleep,
    "sync": _sync,
    "set_tcp": _set_tcp,
    "set_payload": _payload,
    "set_target_payload": _payload,
    "zero_ftsensor": lambda robot: robot.zero_force_sensor(),
    "protective_stop": lambda robot: robot.protective_stop(),
    "halt": _halt,
    "set_standard_digital_out": _output(0, 8),
    "set_digital_out": _output(0, 8),
    "set_configurable_digital_out": _output(8, 8),
    "set_tool_digital_out": _output(16, 2),
    "write_output_integer_register": _register("int"),
    "write_output_float_register": _register("double"),
    "rtde_set_watchdog": _watchdog,
    "textmsg": _ignored,
    "popup": _ignored,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "d2r": lambda _, angle: math.radians(angle),
    "r2d": lambda _, angle: math.degrees(angle),
    "get_actual_tcp_pose": lambda robot: PoseValue(to_ur(robot.body.tcp)),
    "get_target_tcp_pose": lambda robot: PoseValue(to_ur(robot.body.tcp)),
    "get_actual_joint_positions": lambda robot: robot.body.q,
    "get_forward_kin": lambda robot: PoseValue(to_ur(robot.body.tcp)),
    "get_inverse_kin": lambda robot, pose: robot.solved(_frame(pose)),
    "pose_trans": lambda _, a, b: PoseValue(to_ur(compose(_frame(a), _frame(b)))),
    "read_input_integer_register": lambda robot, number: robot.inputs[f"input_int_register_{number}"],
    "read_input_float_register": lambda robot, number: robot.inputs[f"input_double_register_{number}"],
}
