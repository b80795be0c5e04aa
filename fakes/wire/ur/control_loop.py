"""The control program of ur-rtde 1.6.5, emulated: commands in input registers, answers in output registers.

The program polls its registers once per control cycle. The first integer input register holds the number of a
command, the first integer output register 1 (ready) or 2 (done). While a command runs, the registers are not
polled. `COMMANDS` lists the commands that are emulated (scripts/rtde_control.script of ur-rtde); any other
command ends the program.
"""

import math
from collections.abc import Callable, Iterable

from drivers.types import Vector6
from fakes.wire.ur.body import Guided, LinearMove, LinearStop, Thread, ended, move_until_done, six
from fakes.wire.ur.geometry import Frame, from_ur, to_ur
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.runtime import ProgramError

READY, DONE, STOP_SCRIPT = 1, 2, 255
FREEDRIVE_BRAKE = 2.0
"""Deceleration at the end of teach mode, m/s^2."""
_RUNNING_BIT, _MOST_COUNT = 0x8000, 127


class ControlLoop:
    """One run of the control program. offset: the first register that it uses."""

    def __init__(self, robot: Robot, offset: int = 0) -> None:
        self.robot, self.offset = robot, offset
        self._asynchronous: Thread | None = None
        self._writes = self._operations = 0

    def run(self) -> Thread:
        """Run the program and, beside it, its asynchronous operation. Raises `ProgramError`."""
        main = self._poll()
        while not ended(main):
            if self._asynchronous is not None and ended(self._asynchronous):
                self._asynchronous = None
            yield

    def integer(self, index: int) -> int:
        """Return an integer input register."""
        return int(self.robot.inputs[f"input_int_register_{index + self.offset}"])  # type: ignore[arg-type]

    def doubles(self, first: int, count: int) -> tuple[float, ...]:
        """Return consecutive floating-point input registers. Raises `ProgramError` for NaN or infinity."""
        first += self.offset
        names = (f"input_double_register_{i}" for i in range(first, first + count))
        values = tuple(float(self.robot.inputs[name]) for name in names)  # type: ignore[arg-type]
        if not all(map(math.isfinite, values)):
            raise ProgramError(f"registers {first} to {first + count - 1} hold {values}")
        return values

    def joints(self, first: int) -> Vector6:
        """Return six floating-point input registers as joint angles, rad."""
        return six(self.doubles(first, 6))

    def frame(self, first: int) -> Frame:
        """Return six floating-point input registers as a pose."""
        return from_ur(self.doubles(first, 6))

    def answer(self, values: Iterable[float]) -> None:
        """Write floating-point result registers."""
        for i, value in enumerate(values, self.offset):
            self.robot.bank.set(f"output_double_register_{i}", value)

    def answer_integer(self, value: int) -> None:
        """Write the integer result register."""
        self._write_integer(1, value)

    def operate(self, operation: Thread) -> Thread:
        """Run a motion or stop: to its end, or asynchronously if integer register 1 is set.

        An asynchronous operation that still runs is aborted.
        """
        if self._asynchronous is not None:
            self._asynchronous = None
            self._report(running=False)
        if self.integer(1) == 1:
            self._asynchronous = self._reported(operation)
        else:
            yield from operation

    def brake(self, deceleration: float) -> Thread:
        """Brake along the path, as stopl does."""
        body = self.robot.body
        yield from move_until_done(body, LinearStop(body.twist, deceleration))

    def _reported(self, operation: Thread) -> Thread:
        self._report(running=True)
        yield from operation
        self._report(running=False)

    def _report(self, running: bool) -> None:
        """Write the status register of asynchronous operations."""
        self._writes = (self._writes + 1) % (_MOST_COUNT + 1)
        self._operations = (self._operations + running) % (_MOST_COUNT + 1)
        self._write_integer(2, self._writes << 16 | self._operations << 24 | running * _RUNNING_BIT)

    def _poll(self) -> Thread:
        self._report(running=False)
        self._write_integer(0, READY)
        executed = False
        while True:
            command = self.integer(0)
            if command == 0:
                executed = False
                self._write_integer(0, READY)
            elif command == STOP_SCRIPT and not executed:
                return
            elif not executed:
                yield from self._execute(command)
                executed = True
                self._write_integer(0, DONE)
            yield

    def _execute(self, command: int) -> Thread:
        self.robot.commands[command] += 1
        handler = COMMANDS.get(command)
        if handler is None:
            raise ProgramError(f"command {command} of ur-rtde is not emulated")
        yield from handler(self) or ()

    def _write_integer(self, index: int, value: int) -> None:
        self.robot.bank.set(f"output_int_register_{index + self.offset}", value)


def _move_l(loop: ControlLoop) -> Thread:
    target, body = loop.frame(0), loop.robot.body
    loop.robot.solved(target)
    speed, acceleration = loop.doubles(6, 2)
    return loop.operate(move_until_done(body, LinearMove(body.tcp, target, speed, acceleration)))


def _set_payload(loop: ControlLoop) -> None:
    mass, *cog = loop.doubles(0, 4)
    loop.robot.load(mass, tuple(cog) if any(cog) else None)


def _begin_teaching(loop: ControlLoop) -> None:
    loop.robot.body.mover = Guided(loop.robot.hand)


def _end_teaching(loop: ControlLoop) -> Thread | None:
    """Return to position control and brake the arm. Without teach mode nothing happens."""
    return loop.brake(FREEDRIVE_BRAKE) if isinstance(loop.robot.body.mover, Guided) else None


def _start_watchdog(loop: ControlLoop) -> None:
    (least_hz,) = loop.doubles(0, 1)
    loop.robot.watch(f"input_int_register_{loop.offset}", least_hz)


COMMANDS: dict[int, Callable[[ControlLoop], Thread | None]] = {
    3: _move_l,
    8: lambda loop: loop.robot.zero_force_sensor(),
    17: _set_payload,
    18: _begin_teaching,
    19: _end_teaching,
    29: lambda loop: loop.robot.set_tool(loop.frame(0)),
    30: lambda loop: loop.answer(loop.robot.solved(loop.frame(0), loop.joints(6))),
    33: lambda loop: loop.operate(loop.brake(*loop.doubles(0, 1))),
    35: _start_watchdog,
    36: lambda loop: loop.answer_integer(loop.robot.solution(loop.frame(0)) is not None),
    40: lambda loop: loop.answer(to_ur(loop.robot.body.tool)),
    47: lambda loop: loop.answer_integer(loop.robot.steady()),
}
"""Their names in ur-rtde, in this order: moveL, zeroFtSensor, setPayload, teachMode, endTeachMode, setTcp,
getInverseKinematics with a start, stopL, setWatchdog, isPoseWithinSafetyLimits, getTCPOffset and isSteady.
"""
