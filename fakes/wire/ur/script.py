"""Programs on the script ports, and requests to the dashboard on port 29999.

ur-rtde's control program is recognised here and emulated in `control_loop.py`. Any other program belongs to
another user of the arm, which the driver must notice and not disturb. It ends at its first line that is not
`movel(...)`, `movej(...)` or `sleep(...)` with numbers.

The dashboard: one line in, one line out (Universal Robots, "Dashboard Server e-Series"; the replies are
worded as on that page).
"""

import logging
import math
import re
from collections.abc import Callable

from drivers.errors import InputError
from fakes.wire.ur.robot import CYCLE_S, ProgramError, Robot, RobotMode, Thread, move_until_done
from fakes.world.kinematics import six

_log = logging.getLogger(__name__)
LONGEST_PROGRAM = 1_000_000
LONGEST_SLEEP_S = 3600.0
_OPENING = re.compile(r"(def|thread|sec|if|while|for)\b.*:\s*(#.*)?$")
_OFFSET = re.compile(r"reg_offset_float\s*=\s*#[^\n]*\n\s*(\d+)")
_PATH = re.compile(r"def exec_move_path\(\):\n(.*?)\n\s*end\b", re.DOTALL)
_MOVE = re.compile(r"move([jl])\((p?)\[([^\]]*)\]\s*,\s*a=([^,]+),\s*v=([^,)]+)(?:,\s*r=[^)]+)?\)$")
_SLEEP = re.compile(r"sleep\(([^)]*)\)$")


class ProgramReader:
    """Collects the bytes of a client until a program is complete.

    A program with a head (`def name():`) ends at the unindented `end` that closes it. A line outside of such
    a program is a program by itself, as on the controller.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._lines: list[str] = []
        self._depth = self._length = 0

    def feed(self, data: bytes) -> list[str]:
        """Add bytes and return the programs that are now complete.

        Raises `InputError` for a program without an end.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        programs = [p for line in lines if (p := self._take(line.decode("utf-8", errors="replace")))]
        if len(self._rest) + self._length > LONGEST_PROGRAM:
            raise InputError(
                f"script port: a program of more than {LONGEST_PROGRAM} characters; does it end?"
            )
        return programs

    def _take(self, line: str) -> str | None:
        line = line.rstrip("\r")
        if not self._lines and not line.strip():
            return None
        self._lines.append(line)
        self._length += len(line) + 1
        if line[:1] not in (" ", "\t"):
            self._depth += bool(_OPENING.match(line)) - (line.strip() == "end")
        if self._depth > 0:
            return None
        program = "\n".join(self._lines)
        self._lines, self._depth, self._length = [], 0, 0
        return program


def control_program(text: str) -> tuple[int, tuple[str, ...]] | None:
    """Return the first register and the path's motions of ur-rtde's control program, None for any other."""
    offset, path = _OFFSET.search(text), _PATH.search(text)
    if offset is None:
        return None
    lines = (line.split("#")[0].strip() for line in (path[1] if path else "").split("\n"))
    return int(offset[1]), tuple(x for x in lines if x and not x.startswith(("textmsg(", "signal_")))


def run_other(robot: Robot, text: str) -> Thread:
    """Run any other program: its motions and pauses. Raises `ProgramError` for any other line."""
    for line in (line.split("#")[0].strip() for line in text.split("\n")):
        if line and line != "end" and not _OPENING.match(line):
            yield from run_line(robot, line)


def run_line(robot: Robot, line: str) -> Thread:
    """Run `movel`, `movej` (of a pose p[...] or of joints [...]) or `sleep`. Raises `ProgramError`.

    Blend radii are ignored: the arm stops at each target.
    """
    try:
        if match := _MOVE.match(line):
            kind, pose, target, acceleration, speed = match.groups()
            move = robot.move(kind, pose, six(_numbers(target, 6)), float(speed), float(acceleration))
            yield from move_until_done(robot.body, move)
        elif match := _SLEEP.match(line):
            (duration_s,) = _numbers(match[1], 1)
            for _ in range(round(min(max(duration_s, 0.0), LONGEST_SLEEP_S) / CYCLE_S)):
                yield
        else:
            raise ProgramError(f"'{line}' is not simulated")
    except (ValueError, ArithmeticError) as error:
        raise ProgramError(f"'{line}': {error}") from error


def _numbers(text: str, count: int) -> tuple[float, ...]:
    """Parse comma-separated finite numbers. Raises `ValueError`."""
    values = tuple(float(part) for part in text.split(","))
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"{count} finite numbers are needed")
    return values


BANNER = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE = 4096
_SINCE_5S = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)


def reply(robot: Robot, line: str) -> str:
    text = line.strip()
    answer = _REQUESTS.get(text.lower())
    if answer is None:
        _log.warning("simulated controller: dashboard request '%s' is not simulated", text)
        return f'could not understand: "{text}"'
    return answer(robot)


def _stop(robot: Robot) -> str:
    robot.end_program("stopped on the dashboard")
    return "Stopped"


def _power(robot: Robot, mode: RobotMode, done: str) -> str:
    return done if robot.safety.power(mode) else "Failed: emergency stop"


_REQUESTS: dict[str, Callable[[Robot], str]] = {
    "polyscopeversion": lambda robot: "URSoftware {}.{}.{}.{} (Jun 30 2021)".format(*robot.version),
    "get serial number": lambda _: "20265500001",
    "is in remote control": lambda robot: str(robot.safety.remote_control).lower(),
    "running": lambda robot: f"Program running: {str(robot.runtime.running).lower()}",
    "robotmode": lambda robot: f"Robotmode: {robot.safety.robot_mode.name}",
    "safetymode": lambda robot: f"Safetymode: {robot.safety.mode.name}",
    "stop": _stop,
    "unlock protective stop": lambda robot: (
        "Protective stop releasing" if robot.safety.unlock(robot.time_ns) else _SINCE_5S
    ),
    "power on": lambda robot: _power(robot, RobotMode.IDLE, "Powering on"),
    "brake release": lambda robot: _power(robot, RobotMode.RUNNING, "Brake releasing"),
    "close safety popup": lambda _: "closing safety popup",
    "quit": lambda _: "Disconnected",
}


class LineReader:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Add bytes, return the lines that are now complete. Raises `InputError` for a line without end."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            raise InputError(f"dashboard: a line of more than {LONGEST_LINE} bytes")
        return [line.decode("utf-8", errors="replace") for line in lines]
