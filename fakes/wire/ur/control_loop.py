"""The control program of ur-rtde 1.6.5, emulated: commands in input registers, answers in output registers.

The program polls its registers once per control cycle. The first integer input register holds the number of a
command, the first integer output register 1 (ready) or 2 (done). While a command runs, the registers are not
polled. Commands of `REALTIME` run in every cycle while their number is in the register, and the program stays
ready. `COMMANDS` lists the commands that are emulated (scripts/rtde_control.script of ur-rtde); any other
command ends the program.
"""

import math
from collections.abc import Callable, Iterable

from drivers.types import Vector6
from fakes.wire.ur.robot import (
    STEADY_CYCLES,
    Brake,
    ProgramError,
    Robot,
    ServoMove,
    SpeedMove,
    Thread,
    move_until_done,
    run_cycle,
)
from fakes.wire.ur.script import run_line
from fakes.world.kinematics import Frame, from_ur, six, to_ur

READY, DONE, STOP_SCRIPT = 1, 2, 255
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, *range(66, 72)})
FINISHED = -1
FREEDRIVE_BRAKE = 2.0
"""Deceleration at the end of teach mode, m/s^2."""
_RUNNING_BIT, _MOST_COUNT = 0x8000, 127
Command = Callable[["ControlLoop"], Thread | None]
_BUSY = "another thread already controls the arm: call servoStop, speedStop or stopL before the next motion"


class ControlLoop:
    """One run of the control program.

    offset: the first register that it uses. path: the motions of moveJ, moveL or movePath with a path.
    """

    def __init__(self, robot: Robot, offset: int = 0, path: tuple[str, ...] = ()) -> None:
        self.robot, self.offset, self._path = robot, offset, path
        self._asynchronous: Thread | None = None
        self._writes = self._operations = 0

    def run(self) -> Thread:
        """Run the program and, beside it, its asynchronous operation. Raises `ProgramError`."""
        main = self._poll()
        while not run_cycle(main):
            if self._asynchronous is not None and run_cycle(self._asynchronous):
                self._asynchronous = None
            yield

    def integer(self, index: int) -> int:
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
        return six(self.doubles(first, 6))

    def frame(self, first: int) -> Frame:
        return from_ur(self.doubles(first, 6))

    def answer(self, values: Iterable[float]) -> None:
        for i, value in enumerate(values, self.offset):
            self.robot.bank.set(f"output_double_register_{i}", value)

    def operate(self, operation: Thread) -> Thread:
        """Run a motion or stop: to its end, or asynchronously if integer register 1 is set.

        An asynchronous operation that still runs is aborted. Raises `ProgramError` during servoj or speedl.
        """
        if isinstance(self.robot.body.mover, ServoMove | SpeedMove):
            raise ProgramError(_BUSY)
        if self._asynchronous is not None:
            self._asynchronous = None
            self._report(FINISHED)

        def run_reporting() -> Thread:
            self._report(0)
            yield from operation
            self._report(FINISHED)

        if self.integer(1) == 1:
            self._asynchronous = run_reporting()
        else:
            yield from operation

    def stream(self, mover: ServoMove | SpeedMove) -> None:
        """Start servoj or speedl, or continue it. Raises `ProgramError` while another motion runs."""
        other = SpeedMove if isinstance(mover, ServoMove) else ServoMove
        if self._asynchronous is not None or isinstance(self.robot.body.mover, other):
            raise ProgramError(_BUSY)
        self.robot.body.mover = mover

    def brake(self, deceleration: float, linear: bool = True) -> Thread:
        """Brake along the path, as stopl does, or along the way of the joints, as stopj does."""
        body = self.robot.body
        stop = Brake(body.twist if linear else body.qd, deceleration, joint=not linear)
        yield from move_until_done(body, stop)

    def along_path(self) -> Thread:
        """Run the motions of the path; the progress is the index of the motion."""
        for index, line in enumerate(self._path):
            self._report(index)
            yield from run_line(self.robot, line)

    def _report(self, progress: int) -> None:
        """Write the status register of asynchronous operations. progress: 0 at the start, or `FINISHED`."""
        self._writes = (self._writes + 1) % (_MOST_COUNT + 1)
        self._operations = (self._operations + (progress == 0)) % (_MOST_COUNT + 1)
        status = progress | _RUNNING_BIT if progress >= 0 else 0
        self.write_integer(2, self._writes << 16 | self._operations << 24 | status)

    def _poll(self) -> Thread:
        self._report(FINISHED)
        self.write_integer(0, READY)
        executed = False
        while True:
            command = self.integer(0)
            if command in REALTIME:
                yield from self._execute(command)
                self.write_integer(0, READY)
            elif command == 0:
                executed = False
                self.write_integer(0, READY)
            elif command == STOP_SCRIPT and not executed:
                return
            elif not executed:
                yield from self._execute(command)
                executed = True
                self.write_integer(0, DONE)
            yield

    def _execute(self, command: int) -> Thread:
        self.robot.commands[command] += 1
        handler = COMMANDS.get(command)
        if handler is None:
            name = _OTHER_NAMES.get(command, f"command {command}")
            raise ProgramError(f"{name} of ur-rtde is not simulated; docs/simulated.md lists the calls")
        yield from handler(self) or ()

    def write_integer(self, index: int, value: int) -> None:
        self.robot.bank.set(f"output_int_register_{index + self.offset}", value)


def _move(kind: str, pose: str) -> Command:
    def command(loop: ControlLoop) -> Thread:
        speed, acceleration = loop.doubles(6, 2)
        mover = loop.robot.move(kind, pose, loop.joints(0), speed, acceleration)
        return loop.operate(move_until_done(loop.robot.body, mover))

    return command


def _speed(joint: bool) -> Command:
    def command(loop: ControlLoop) -> None:
        body = loop.robot.body
        mover = body.mover
        if not isinstance(mover, SpeedMove) or mover.joint is not joint:
            mover = SpeedMove(body.qd if joint else body.twist, joint)
        mover.target, (mover.acceleration,) = loop.joints(0), loop.doubles(6, 1)
        loop.stream(mover)

    return command


def _servo_j(loop: ControlLoop) -> None:
    body = loop.robot.body
    mover = body.mover if isinstance(body.mover, ServoMove) else ServoMove(body.qd)
    time_s, lookahead_s, gain = loop.doubles(8, 3)
    mover.aim(loop.robot.in_range(loop.joints(0)), time_s, lookahead_s, gain)
    loop.stream(mover)


def _stop(linear: bool) -> Command:
    return lambda loop: loop.operate(loop.brake(loop.doubles(0, 1)[0], linear))


def _speed_stop(loop: ControlLoop) -> Thread:
    mover = loop.robot.body.mover
    return loop.brake(loop.doubles(0, 1)[0], linear=not (isinstance(mover, SpeedMove) and mover.joint))


def _has_solution(loop: ControlLoop) -> None:
    loop.write_integer(1, loop.robot.solution(loop.frame(0)) is not None)


def _teach(loop: ControlLoop) -> None:
    loop.robot.body.mover = loop.robot.hand


def _end_teaching(loop: ControlLoop) -> Thread | None:
    """Return to position control and brake the arm. Without teach mode nothing happens."""
    return loop.brake(FREEDRIVE_BRAKE) if loop.robot.body.mover is loop.robot.hand else None


COMMANDS: dict[int, Command] = {
    1: _move("j", ""),
    2: _move("j", "p"),
    3: _move("l", "p"),
    4: _move("l", ""),
    8: lambda loop: loop.robot.zero_force_sensor(),
    9: _speed(joint=True),
    10: _speed(joint=False),
    11: _servo_j,
    15: _speed_stop,
    16: lambda loop: loop.brake(loop.doubles(0, 1)[0]),
    17: lambda loop: loop.robot.load(*loop.doubles(0, 4)),
    18: _teach,
    19: _end_teaching,
    29: lambda loop: loop.robot.set_tool(loop.frame(0)),
    30: lambda loop: loop.answer(loop.robot.solve(loop.frame(0), loop.joints(6))),
    31: lambda loop: loop.robot.safety.protective_stop(loop.robot.time_ns),
    33: _stop(linear=True),
    34: _stop(linear=False),
    35: lambda loop: loop.robot.runtime.watch(
        f"input_int_register_{loop.offset}", loop.doubles(0, 1)[0], loop.robot.time_ns
    ),
    36: _has_solution,
    40: lambda loop: loop.answer(to_ur(loop.robot.body.tool)),
    45: lambda loop: loop.operate(loop.along_path()),
    46: lambda loop: loop.answer(loop.robot.solve(loop.frame(0))),
    47: lambda loop: loop.write_integer(1, loop.robot.body.still_cycles >= STEADY_CYCLES),
    60: _has_solution,
    61: _has_solution,
}
"""Their names in ur-rtde, in this order: moveJ, moveJ_IK, moveL, moveL_FK, zeroFtSensor, speedJ, speedL,
servoJ, speedStop, servoStop, setPayload, teachMode, endTeachMode, setTcp, getInverseKinematics with a start,
triggerProtectiveStop, stopL, stopJ, setWatchdog, isPoseWithinSafetyLimits, getTCPOffset, movePath (moveJ,
moveL), getInverseKinematics, isSteady, getInverseKinematicsHasSolution without and with a start.
"""
_OTHER_NAMES = {
    6: "forceMode", 7: "forceModeStop", 12: "servoC", 20: "forceModeSetDamping",
    21: "forceModeSetGainScaling", 24: "servoL", 25: "toolContact", 26: "getStepTime",
    27: "getActualJointPositionsHistory", 28: "getTargetWaypoint", 37: "isJointsWithinSafetyLimits",
    38: "getJointTorques", 39: "poseTrans", 41: "jogStart", 42: "jogStop", 43: "getForwardKinematics",
    44: "getForwardKinematics", 51: "moveUntilContact", 52: "freedriveMode", 53: "endFreedriveMode",
    54: "getFreedriveStatus", 56: "ftRtdeInputEnable", 57: "enableExternalFtSensor",
    58: "getActualToolFlangePose", 59: "setGravity", 62: "startContactDetection",
    63: "stopContactDetection", 64: "readContactDetection",
    65: "setTargetPayload", 66: "directTorque", 67: "getMassMatrix", 68: "getCoriolisAndCentrifugalTorques",
    69: "getTargetJointAccelerations", 70: "getJacobian", 71: "getJacobianTimeDerivative",
}  # fmt: skip
"""Names in ur-rtde of the commands that are not emulated, for messages."""
