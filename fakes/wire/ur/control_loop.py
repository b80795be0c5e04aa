"""The control program of ur-rtde 1.6.5, emulated: commands in input registers, answers in output registers.

The program polls its registers once per control cycle. The first integer input register holds the number of a
command, the first integer output register 1 (ready) or 2 (done). While a command runs, the registers are not
polled. `COMMANDS` lists the commands that are emulated (scripts/rtde_control.script of ur-rtde); any other
command ends the program.
"""

import math
from collections.abc import Callable, Iterable

from drivers.types import Vector6
from fakes.wire.ur.body import ArmMover, Guided, JointMove, JointStop, LinearMove, LinearStop, Thread
from fakes.wire.ur.body import move_until_done as run_mover
from fakes.wire.ur.frames import Frame, compose, from_ur, to_ur
from fakes.wire.ur.kinematics import forward
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.runtime import ProgramError
from fakes.wire.ur.script import ControlProgram

READY, DONE, STOP_SCRIPT = 1, 2, 255
FINISHED = -1
FREEDRIVE_BRAKE = 2.0
_RUNNING_BIT, _MOST_PROGRESS, _MOST_COUNT = 0x8000, 0x7FFF, 127


class AsyncStatus:
    """The register that reports asynchronous motions: progress, running bit, count of writes, operation."""

    def __init__(self) -> None:
        self._writes = self._operation = 0

    def after(self, progress: int) -> int:
        """Return the register's value after a progress is reported; 0 starts an operation, -1 ends it."""
        self._writes = (self._writes + 1) % (_MOST_COUNT + 1)
        if progress == 0:
            self._operation = (self._operation + 1) % (_MOST_COUNT + 1)
        value = self._writes << 16 | self._operation << 24
        return value + min(progress, _MOST_PROGRESS) + _RUNNING_BIT if progress >= 0 else value


class ControlLoop:
    """One run of the control program."""

    def __init__(self, robot: Robot, program: ControlProgram) -> None:
        self.robot, self.offset = robot, program.offset
        self._stop_is_linear = False  # ur-rtde 1.6.5: only an asynchronous stop sets it
        self._status = AsyncStatus()
        self._moving: Thread | None = None
        self._stopping: Thread | None = None
        self._main = self._run()

    def step(self) -> bool:
        """Run one control cycle; return whether the program goes on. Raises `ProgramError`."""
        try:
            if _ended(self._main):
                return False
            if self._moving is not None and _ended(self._moving):
                self._moving = None
            if self._stopping is not None and _ended(self._stopping):
                self._stopping = None
        except (ValueError, ArithmeticError) as error:
            raise ProgramError(f"a calculation failed: {error}") from error
        return True

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
        a, b, c, d, e, f = self.doubles(first, 6)
        return a, b, c, d, e, f

    def frame(self, first: int) -> Frame:
        """Return six floating-point input registers as a pose."""
        return from_ur(self.doubles(first, 6))

    def answer_integer(self, value: int) -> None:
        """Write the integer result register."""
        self._write_integer(1, value)

    def answer(self, values: Iterable[float]) -> None:
        """Write floating-point result registers."""
        for i, value in enumerate(values, self.offset):
            self.robot.bank.set(f"output_double_register_{i}", value)

    def report(self, progress: int) -> None:
        """Write the asynchronous status register."""
        self._write_integer(2, self._status.after(progress))

    def move(self, mover: ArmMover) -> Thread:
        """Run a motion: to its end, or asynchronously if integer register 1 is set."""
        self._abort_async_move()
        if self.integer(1) == 1:
            self._moving = self._as_operation(run_mover(self.robot.body, mover))
        else:
            yield from run_mover(self.robot.body, mover)

    def stop(self) -> Thread:
        """Run stopL or stopJ. Which of them, the script derives from the stop before."""
        (deceleration,), asynchronous = self.doubles(0, 1), self.integer(1) == 1
        if self._stopping is not None:
            self._stopping = None
            self.report(FINISHED)
        else:
            self._abort_async_move()
        if asynchronous:
            self._stop_is_linear = True
            self._stopping = self._as_operation(self.brake(deceleration, linear=True))
        else:
            yield from self.brake(deceleration, self._stop_is_linear)

    def brake(self, deceleration: float, linear: bool) -> Thread:
        """Brake as stopl or stopj do."""
        body = self.robot.body
        yield from run_mover(
            body, LinearStop(body.twist, deceleration) if linear else JointStop(body.qd, deceleration)
        )

    def _abort_async_move(self) -> None:
        if self._moving is not None:
            self._moving = None
            self.report(FINISHED)

    def _run(self) -> Thread:
        self.report(FINISHED)
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

    def _as_operation(self, thread: Thread) -> Thread:
        self.report(0)
        yield from thread
        self.report(FINISHED)

    def _write_integer(self, index: int, value: int) -> None:
        self.robot.bank.set(f"output_int_register_{index + self.offset}", value)


def _ended(thread: Thread) -> bool:
    """Run a thread for one cycle; return whether it has ended."""
    try:
        next(thread)
    except StopIteration:
        return True
    return False


def _move_j(loop: ControlLoop) -> Thread:
    speed, acceleration = loop.doubles(6, 2)
    target = loop.robot.allowed(loop.joints(0))
    return loop.move(JointMove(loop.robot.body.q, target, speed, acceleration))


def _move_l(loop: ControlLoop) -> Thread:
    loop.robot.solved(loop.frame(0))
    speed, acceleration = loop.doubles(6, 2)
    return loop.move(LinearMove(loop.robot.body.tcp, loop.frame(0), speed, acceleration))


def _set_payload(loop: ControlLoop) -> None:
    mass, *cog = loop.doubles(0, 4)
    loop.robot.load(mass, tuple(cog) if any(cog) else None)


def _begin_teaching(loop: ControlLoop) -> None:
    loop.robot.body.mover = Guided(loop.robot.hand)


def _end_teaching(loop: ControlLoop) -> Thread | None:
    """Return to position control: the arm brakes where it is. Without teach mode nothing happens."""
    return loop.brake(FREEDRIVE_BRAKE, linear=True) if isinstance(loop.robot.body.mover, Guided) else None


def _start_watchdog(loop: ControlLoop) -> None:
    (least_hz,) = loop.doubles(0, 1)
    loop.robot.watch(f"input_int_register_{loop.offset}", least_hz)


COMMANDS: dict[int, Callable[[ControlLoop], Thread | None]] = {
    1: _move_j,
    3: _move_l,
    8: lambda loop: loop.robot.zero_force_sensor(),
    17: _set_payload,
    18: _begin_teaching,
    19: _end_teaching,
    29: lambda loop: loop.robot.set_tool(loop.frame(0)),
    30: lambda loop: loop.answer(loop.robot.solved(loop.frame(0), loop.joints(6))),
    31: lambda loop: loop.robot.protective_stop(),
    33: ControlLoop.stop,
    34: ControlLoop.stop,
    35: _start_watchdog,
    36: lambda loop: loop.answer_integer(loop.robot.reachable(loop.frame(0))),
    37: lambda loop: loop.answer_integer(loop.robot.within_limits(loop.joints(0))),
    40: lambda loop: loop.answer(to_ur(loop.robot.body.tool)),
    44: lambda loop: loop.answer(to_ur(compose(forward(loop.joints(0)), loop.frame(6)))),
    46: lambda loop: loop.answer(loop.robot.solved(loop.frame(0))),
    47: lambda loop: loop.answer_integer(loop.robot.steady()),
}
"""Their names in ur-rtde, in this order: moveJ, moveL, zeroFtSensor, setPayload, teachMode, endTeachMode,
setTcp, getInverseKinematics with a start, triggerProtectiveStop, stopL, stopJ, setWatchdog,
isPoseWithinSafetyLimits, isJointsWithinSafetyLimits, getTCPOffset, getForwardKinematics, getInverseKinematics
without a start, and isSteady.
"""
