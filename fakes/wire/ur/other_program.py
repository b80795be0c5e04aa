"""A program that is not ur-rtde's: another user of the arm, whom the driver must notice and not disturb."""

import math
import re
from collections.abc import Iterator

from fakes.wire.ur.body import LinearMove, Thread, move_until_done
from fakes.wire.ur.frames import from_ur
from fakes.wire.ur.robot import CYCLE_S, Robot
from fakes.wire.ur.runtime import ProgramError
from fakes.wire.ur.script import OtherProgram

LONGEST_SLEEP_S = 3600.0
_MOVE = re.compile(r"movel\(p\[([^\]]*)\]\s*,\s*a=([^,]+),\s*v=([^,)]+)\)$")
_SLEEP = re.compile(r"sleep\(([^)]*)\)$")


class OtherProgramRun:
    """One run. Lines `movel(p[x, y, z, rx, ry, rz], a=..., v=...)` and `sleep(s)` run in turn."""

    def __init__(self, robot: Robot, program: OtherProgram) -> None:
        self._robot, self._program = robot, program
        self._steps = self._run()

    def step(self) -> bool:
        """Run one control cycle; return whether the program goes on. Raises `ProgramError`."""
        return next(self._steps, False)

    def _run(self) -> Iterator[bool]:
        for line in self._program.lines:
            try:
                for _ in self._carry_out(line):
                    yield True
            except (ValueError, ArithmeticError) as error:
                raise ProgramError(f"'{line}': {error}") from error

    def _carry_out(self, line: str) -> Thread:
        if match := _MOVE.match(line):
            pose, acceleration, speed = _numbers(match[1], 6), float(match[2]), float(match[3])
            target, body = from_ur(pose), self._robot.body
            self._robot.solved(target)
            yield from move_until_done(body, LinearMove(body.tcp, target, speed, acceleration))
        elif match := _SLEEP.match(line):
            (duration_s,) = _numbers(match[1], 1)
            for _ in range(round(min(max(duration_s, 0.0), LONGEST_SLEEP_S) / CYCLE_S)):
                yield


def _numbers(text: str, count: int) -> tuple[float, ...]:
    """Parse comma-separated finite numbers. Raises `ValueError`."""
    values = tuple(float(part) for part in text.split(","))
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"{count} finite numbers are needed")
    return values
