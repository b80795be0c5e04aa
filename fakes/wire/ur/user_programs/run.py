"""One run of a user's program: statement after statement, as many a cycle as take no time."""

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

from fakes.wire.ur.control_loop import Thread
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.runtime import ProgramError
from fakes.wire.ur.script import ScriptProgram
from fakes.wire.ur.user_programs.functions import ACTIONS, FUNCTIONS, PoseValue
from fakes.wire.ur.user_programs.statements import Do, If, Left, Statement, While, parse_statements

STATEMENTS_A_CYCLE = 200
"""A program that does more without waiting goes on in the next cycle: none can hold up the controller."""
LARGEST_WHOLE = 2**31
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
}
_COMPARISONS: dict[type, Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


class ScriptRun:
    """One run. Unknown functions and constructs are left out, and listed in `skipped`."""

    def __init__(self, robot: Robot, program: ScriptProgram) -> None:
        self._robot, self.name = robot, program.name
        self._left: dict[str, None] = {}
        self._names: dict[str, Any] = {"True": True, "False": False, "pi": math.pi}
        self._done = 0
        self._main = self._run(parse_statements(program.lines))

    @property
    def skipped(self) -> list[str]:
        """Lines that were not carried out."""
        return list(self._left)

    def step(self) -> bool:
        """One cycle; returns whether the program goes on. Raises `ProgramError`."""
        self._done = 0
        try:
            next(self._main)
        except StopIteration:
            return False
        return True

    def _run(self, statements: tuple[Statement, ...]) -> Thread:
        for statement in statements:
            yield from self._breath()
            try:
                yield from self._carry_out(statement)
            except LookupError:
                self._left[statement.text] = None
            except ProgramError:
                raise
            except Exception as error:  # whatever a user's text can do wrong ends that program alone
                raise ProgramError(f"'{statement.text}': {error}") from error

    def _breath(self) -> Thread:
        self._done += 1
        if self._done > STATEMENTS_A_CYCLE:
            yield

    def _carry_out(self, statement: Statement) -> Thread:
        match statement:
            case Left():
                raise LookupError
            case Do(_, ast.Assign(targets=[target], value=value)):
                self._assign(target, self._value(value))
            case Do(_, ast.Call() as call):
                yield from self._call(call) or ()
            case While(_, condition, body):
                while self._value(condition):
                    yield from self._run(body)
                    yield from self._breath()
            case If(_, branches):
                for condition, body in branches:
                    if condition is None or self._value(condition):
                        yield from self._run(body)
                        break
            case _:
                raise LookupError

    def _assign(self, target: ast.expr, value: Any) -> None:
        match target:
            case ast.Name(name):
                self._names[name] = value
            case ast.Subscript(ast.Name(name), index):
                old, at = self._names[name], self._value(index)
                items = list(old)
                items[at] = _number(value)
                self._names[name] = type(old)(items)
            case _:
                raise LookupError

    def _call(self, call: ast.Call) -> Thread | None:
        action = ACTIONS[getattr(call.func, "id", "")]
        values = [self._value(a) for a in call.args]
        return action(self._robot, *values, **{k.arg or "": self._value(k.value) for k in call.keywords})

    def _value(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return self._names[name]
            case ast.List(items) | ast.Tuple(items):
                return tuple(_number(self._value(item)) for item in items)
            case ast.Subscript(ast.Name("p"), ast.Tuple(items)):
                return PoseValue(_number(self._value(item)) for item in items)
            case ast.Subscript(value, index):
                return self._value(value)[self._value(index)]
            case ast.Call(ast.Name(name), arguments):
                return FUNCTIONS[name](self._robot, *(self._value(a) for a in arguments))
        return self._operation(node)

    def _operation(self, node: ast.expr) -> Any:
        match node:
            case ast.UnaryOp(ast.USub(), operand):
                return -_number(self._value(operand))
            case ast.UnaryOp(ast.Not(), operand):
                return not self._value(operand)
            case ast.BinOp(left, kind, right):
                return _number(
                    _OPERATORS[type(kind)](_number(self._value(left)), _number(self._value(right)))
                )
            case ast.Compare(left, [kind], [right]):
                return _COMPARISONS[type(kind)](self._value(left), self._value(right))
            case ast.BoolOp(kind, parts):
                together = all if isinstance(kind, ast.And) else any
                return together(self._value(part) for part in parts)
        raise LookupError


def _number(value: Any) -> float:
    """A number as it is. Raises `TypeError` for anything else, `OverflowError` beyond 32 bits."""
    if not isinstance(value, int | float):
        raise TypeError(f"{type(value).__name__} instead of a number")
    if isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        raise OverflowError("a whole number beyond 32 bits")
    return value
