"""The control program of ur-rtde 1.6.5, emulated: registers in, motions and registers out.

Its loop runs once a control cycle. Commands are numbers in the first integer input register;
the first integer output register says 1 (ready) or 2 (done). While a command runs, the loop does
not look at the registers. A generator that yields once a cycle is a thread of the program.
"""

import math
from collections.abc import Callable, Generator, Iterable, Mapping

from drivers.types import Vector6
from fakes.wire.ur.body import ArmMover, JointMove, JointStop, LinearMove, LinearStop
from fakes.wire.ur.frames import Frame, from_ur
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.runtime import ProgramError
from fakes.wire.ur.script import ControlProgram, Waypoint

Thread = Generator[None, None, None]
Command = Callable[["ControlLoop"], Thread | None]
READY, DONE, STOP_SCRIPT = 1, 2, 255
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, *range(66, 72)})
FINISHED = -1
_RUNNING_BIT, _MOST_PROGRESS, _MOST_COUNT = 0x8000, 0x7FFF, 127


class AsyncStatus:
    """The register in which asynchronous motions report: progress, running, writes, operation."""

    def __init__(self) -> None:
        self._writes = self._operation = 0

    def after(self, progress: int) -> int:
        """The register's value after reporting a progress; 0 begins an operation, -1 ends it."""
        self._writes = (self._writes + 1) % (_MOST_COUNT + 1)
        if progress == 0:
            self._operation = (self._operation + 1) % (_MOST_COUNT + 1)
        value = self._writes << 16 | self._operation << 24
        return value + min(progress, _MOST_PROGRESS) + _RUNNING_BIT if progress >= 0 else value


class ControlLoop:
    """One run of the control program. commands: what each command number does."""

    def __init__(self, robot: Robot, program: ControlProgram, commands: Mapping[int, Command]) -> None:
        self.robot, self.program = robot, program
        self.contact_cycles = 0
        """How long before it was noticed the watched contact began; 0 while there was none."""
        self._stop_is_linear = False  # 1.6.5: only an asynchronous stop sets it
        self._contact_watch = self._contact_due = False
        self._status = AsyncStatus()
        self._commands = commands
        self._moving: Thread | None = None
        self._stopping: Thread | None = None
        self._main = self._run()

    def step(self) -> bool:
        """One cycle; returns whether the program goes on. Raises `ProgramError`."""
        try:
            return self._step()
        except (ValueError, ArithmeticError) as error:
            raise ProgramError(f"a calculation failed: {error}") from error

    def _step(self) -> bool:
        if _ended(self._main):
            return False
        if self._moving is not None and _ended(self._moving):
            self._moving = None
        if self._stopping is not None and _ended(self._stopping):
            self._stopping = None
        if self._contact_watch and (cycles := self.robot.contact_cycles()):
            self._contact_watch, self._contact_due, self.contact_cycles = False, True, cycles
        return True

    def integer(self, index: int) -> int:
        """An integer input register."""
        return int(self.robot.inputs[f"input_int_register_{index + self.program.offset}"])  # type: ignore[arg-type]

    def doubles(self, first: int, count: int = 6) -> tuple[float, ...]:
        """Consecutive floating-point input registers. Raises `ProgramError` unless they are numbers."""
        first += self.program.offset
        values = tuple(
            float(self.robot.inputs[f"input_double_register_{i}"])  # type: ignore[arg-type]
            for i in range(first, first + count)
        )
        if not all(map(math.isfinite, values)):
            raise ProgramError(f"registers {first} to {first + count - 1} hold {values}")
        return values

    def joints(self, first: int) -> Vector6:
        """Six input registers as joint values."""
        a, b, c, d, e, f = self.doubles(first)
        return a, b, c, d, e, f

    def frame(self, first: int) -> Frame:
        """Six input registers as a pose."""
        return from_ur(self.doubles(first))

    def answer_integer(self, value: int) -> None:
        """Write the integer result register."""
        self._write_integer(1, value)

    def answer(self, values: Iterable[float], first: int = 0) -> None:
        """Write floating-point result registers."""
        for i, value in enumerate(values, first + self.program.offset):
            self.robot.bank.set(f"output_double_register_{i}", value)

    def report(self, progress: int) -> None:
        """Write the asynchronous status register."""
        self._write_integer(2, self._status.after(progress))

    def run_mover(self, mover: ArmMover) -> Thread:
        """Move until the motion has ended or something else took its place."""
        body = self.robot.body
        body.mover = mover
        while body.mover is mover:
            yield

    def move(self, movers: Iterable[ArmMover]) -> Thread:
        """Run motions one after the other, here or (int register 1) in the move thread."""
        self.stop_async_move()
        thread = self._in_turn(movers)
        if self.integer(1) == 1:
            self._moving = self._as_operation(thread)
        else:
            yield from thread

    def stop(self) -> Thread:
        """Do stopL or stopJ, whose kind the script takes from what was stopped before."""
        deceleration, asynchronous = self.doubles(0, 1)[0], self.integer(1) == 1
        if self._stopping is not None:
            self._stopping = None
            self.report(FINISHED)
        else:
            self.stop_async_move()
        if asynchronous:
            self._stop_is_linear = True
            self._stopping = self._as_operation(self.brake(deceleration, linear=True))
        else:
            yield from self.brake(deceleration, self._stop_is_linear)

    def brake(self, deceleration: float, linear: bool) -> Thread:
        """Brake as stopl or stopj do."""
        body = self.robot.body
        yield from self.run_mover(
            LinearStop(body.twist, deceleration) if linear else JointStop(body.qd, deceleration)
        )

    def stop_async_move(self) -> None:
        """Kill the move thread."""
        if self._moving is not None:
            self._moving = None
            self.report(FINISHED)

    def watch_contact(self, on: bool) -> None:
        """Begin or end the watch that stops a motion at contact."""
        self._contact_watch = on
        if on:
            self.contact_cycles = 0

    def mover_of(self, waypoint: Waypoint) -> ArmMover:
        """The motion of a path's waypoint from where the arm is."""
        body = self.robot.body
        target = from_ur(waypoint.values) if waypoint.is_pose else self.robot.tcp_at(_six(waypoint.values))
        if waypoint.function == "movej":
            joints = self.robot.solved(target) if waypoint.is_pose else _six(waypoint.values)
            return JointMove(body.q, joints, waypoint.speed, waypoint.acceleration)
        self.robot.solved(target)
        return LinearMove(body.tcp, target, waypoint.speed, waypoint.acceleration)

    def path(self) -> Iterable[ArmMover]:
        """The motions of the uploaded path, reporting which one is on."""
        for number, waypoint in enumerate(self.program.path):
            self.report(number)
            yield self.mover_of(waypoint)

    def _run(self) -> Thread:
        self.report(FINISHED)
        self._signal(READY)
        executing = False
        while True:
            command = self.integer(0)
            if command in REALTIME:
                self._start(command)
                self._signal(READY)
            elif command == 0:
                executing = False
                if self._contact_due:
                    self._contact_due = False
                    self.stop_async_move()
                    yield from self.return_to_contact(self.contact_cycles)
                self._signal(READY)
            elif not executing:
                if command == STOP_SCRIPT:
                    return
                yield from self._start(command)
                executing = True
                self._signal(DONE)
            yield

    def _start(self, command: int) -> Thread:
        self.robot.count(command)
        handler = self._commands.get(command)
        return (handler(self) if handler else None) or _nothing()

    def return_to_contact(self, cycles: int) -> Thread:
        """Brake and go back to where the arm was `cycles` ago."""
        joints = self.robot.joints_before(cycles)
        yield from self.brake(3.0, linear=True)
        body = self.robot.body
        yield from self.run_mover(LinearMove(body.tcp, self.robot.tcp_at(joints), 0.25, 1.2))

    def _in_turn(self, movers: Iterable[ArmMover]) -> Thread:
        for mover in movers:
            yield from self.run_mover(mover)

    def _as_operation(self, thread: Thread) -> Thread:
        self.report(0)
        yield from thread
        self.report(FINISHED)

    def _signal(self, value: int) -> None:
        self._write_integer(0, value)

    def _write_integer(self, index: int, value: int) -> None:
        self.robot.bank.set(f"output_int_register_{index + self.program.offset}", value)


def _nothing() -> Thread:
    yield from ()


def _ended(thread: Thread) -> bool:
    """Let a thread run for a cycle; return whether it has ended."""
    try:
        next(thread)
    except StopIteration:
        return True
    return False


def _six(values: tuple[float, ...]) -> Vector6:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f
