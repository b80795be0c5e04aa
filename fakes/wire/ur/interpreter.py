"""Programs of the user's own, as far as a bench needs them: straight lines of calls and assignments.

Motions, stops, sleep, TCP, payload, outputs and registers are carried out. Control flow, threads
and unknown functions are not: such a line is skipped and listed in `skipped`.
"""

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

from drivers.types import Vector6
from fakes.wire.ur.body import ArmMover, JointMove, JointStop, LinearMove, LinearStop
from fakes.wire.ur.control_loop import Thread
from fakes.wire.ur.frames import Frame, compose, from_ur, to_ur
from fakes.wire.ur.robot import CYCLE_S, ProgramError, Robot
from fakes.wire.ur.script import ScriptProgram, parse_call

_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
LONGEST_SLEEP_S = 3600.0


class PoseValue(tuple[float, ...]):
    """p[...]: a pose, as against a list of joint angles."""


class ScriptRun:
    """One run of a user's program."""

    def __init__(self, robot: Robot, program: ScriptProgram) -> None:
        self._robot, self.name = robot, program.name
        self.skipped: list[str] = []
        self._names: dict[str, Any] = {"True": True, "False": False, "pi": math.pi}
        self._main = self._run(program.lines)

    def step(self) -> bool:
        """One cycle; returns whether the program goes on. Raises `ProgramError`."""
        try:
            next(self._main)
        except StopIteration:
            return False
        return True

    def _run(self, lines: tuple[str, ...]) -> Thread:
        for line in lines:
            statement = parse_call(line)
            try:
                if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                    self._names[statement.targets[0].id] = self._value(statement.value)
                elif isinstance(statement, ast.Call):
                    yield from self._call(statement) or ()
                else:
                    raise LookupError(line)
            except LookupError:
                self.skipped.append(line)
            except (TypeError, ValueError, ArithmeticError) as error:
                raise ProgramError(f"'{line}': {error}") from error

    def _call(self, call: ast.Call) -> Thread | None:
        name = getattr(call.func, "id", "")
        action = _ACTIONS[name]
        values = [self._value(a) for a in call.args]
        return action(self._robot, *values, **{k.arg or "": self._value(k.value) for k in call.keywords})

    def _value(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return self._names[name]
            case ast.List(items):
                return tuple(self._value(item) for item in items)
            case ast.UnaryOp(ast.USub(), operand):
                return -self._value(operand)
            case ast.BinOp(left, kind, right):
                return _OPERATORS[type(kind)](self._value(left), self._value(right))
            case ast.Subscript(ast.Name("p"), ast.Tuple(items)):
                return PoseValue(self._value(item) for item in items)
            case ast.Subscript(value, index):
                return self._value(value)[self._value(index)]
            case ast.Call(ast.Name(name), arguments):
                return _FUNCTIONS[name](self._robot, *(self._value(a) for a in arguments))
        raise LookupError(ast.dump(node))


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


def _sleep(robot: Robot, duration_s: float) -> Thread:
    for _ in range(round(min(max(duration_s, 0.0), LONGEST_SLEEP_S) / CYCLE_S)):
        yield


def _sync(robot: Robot) -> Thread:
    yield


def _set_tcp(robot: Robot, pose: tuple[float, ...], *_: object) -> None:
    robot.body.tool = _frame(pose)
    robot.tool_changed()


def _payload(robot: Robot, mass: float, cog: tuple[float, ...] | None = None, *_: object) -> None:
    robot.load(mass, cog)


def _halt(robot: Robot) -> None:
    raise ProgramError("halt")


def _output(first: int) -> Callable[[Robot, int, bool], None]:
    return lambda robot, number, level: robot.io.set_digital(
        1 << number + first, bool(level) << number + first
    )


def _register(kind: str) -> Callable[[Robot, int, float], None]:
    return lambda robot, number, value: robot.bank.set(f"output_{kind}_register_{int(number)}", value)


def _ignored(robot: Robot, *_: object, **__: object) -> None:
    """Has an effect on the pendant only."""


_ACTIONS: dict[str, Callable[..., Thread | None]] = {
    "movej": _move_j,
    "movel": _move_l,
    "movep": _move_l,
    "stopj": lambda robot, a=2.0: _until(robot, JointStop(robot.body.qd, a)),
    "stopl": lambda robot, a=2.0: _until(robot, LinearStop(robot.body.twist, a)),
    "sleep": _sleep,
    "sync": _sync,
    "set_tcp": _set_tcp,
    "set_payload": _payload,
    "set_target_payload": _payload,
    "zero_ftsensor": lambda robot: robot.zero_force_sensor(),
    "protective_stop": lambda robot: robot.protective_stop(),
    "halt": _halt,
    "set_standard_digital_out": _output(0),
    "set_digital_out": _output(0),
    "set_configurable_digital_out": _output(8),
    "set_tool_digital_out": _output(16),
    "write_output_integer_register": _register("int"),
    "write_output_float_register": _register("double"),
    "textmsg": _ignored,
    "popup": _ignored,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
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
