"""Programs as they arrive on the script ports: where one ends, and which kind it is.

The control program of ur-rtde is recognised, not interpreted: what differs between uploads is its
register offset and the path it was given, and those are read. Any other program is kept as lines.
"""

import re
from dataclasses import dataclass

from drivers.errors import InputError

LONGEST_PROGRAM = 1_000_000
_OPENING = re.compile(r"(def|thread|sec|if|while|for)\b.*:\s*(#.*)?$")
_OFFSET = re.compile(r"reg_offset_float\s*=\s*#[^\n]*\n\s*(\d+)")
_PATH = re.compile(r"def exec_move_path\(\):\n(.*?)\n\s*end\b", re.DOTALL)
_WAYPOINT = re.compile(
    r"(movej|movel|movep)\((p?)\[([^\]]*)\]\s*,\s*a=([^,]+),\s*v=([^,]+),\s*r=([^)]+)\)",
)


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One motion of a path: `values` are joints in rad or, with `is_pose`, a pose x y z rx ry rz."""

    function: str
    is_pose: bool
    values: tuple[float, ...]
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class ControlProgram:
    """The program of ur-rtde: the first register it uses, and the path of `movePath` and its kin."""

    offset: int
    path: tuple[Waypoint, ...]


@dataclass(frozen=True, slots=True)
class ScriptProgram:
    """Any other program: its lines, stripped, without comments and empty lines."""

    name: str
    lines: tuple[str, ...]


class ProgramReader:
    """Collects what a client sends until a program is whole.

    A program with a head (`def name():`) ends at the unindented `end` that closes it; a line
    outside of one is a program of its own, as on the controller.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._lines: list[str] = []
        self._depth = self._length = 0

    def feed(self, data: bytes) -> list[str]:
        """Take bytes; return the programs that are whole now. Raises `InputError` when one never ends."""
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


def recognise(text: str) -> ControlProgram | ScriptProgram:
    """Tell ur-rtde's control program from any other. Raises `InputError` for one it cannot read."""
    offset = _OFFSET.search(text)
    if offset is None:
        return _other(text)
    path = _PATH.search(text)
    return ControlProgram(int(offset[1]), _waypoints(path[1]) if path else ())


def _waypoints(text: str) -> tuple[Waypoint, ...]:
    return tuple(_waypoint(match) for match in _WAYPOINT.finditer(text))


def _waypoint(match: re.Match[str]) -> Waypoint:
    function, pose, values, acceleration, speed, _ = match.groups()
    try:
        numbers = tuple(float(v) for v in values.split(","))
        waypoint = Waypoint(function, pose == "p", numbers, float(speed), float(acceleration))
    except ValueError as error:
        raise InputError(f"script: '{match[0]}' is not a motion: {error}") from error
    if len(numbers) != 6:
        raise InputError(f"script: '{match[0]}' has {len(numbers)} values instead of 6")
    return waypoint


def _other(text: str) -> ScriptProgram:
    lines = [line.split("#")[0].strip() for line in text.split("\n")]
    head = re.match(r"(?:def|sec)\s+(\w+)", lines[0])
    body = lines[1:-1] if head else lines
    return ScriptProgram(head[1] if head else "unnamed", tuple(line for line in body if line))
