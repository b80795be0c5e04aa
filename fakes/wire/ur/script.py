"""Programs as they arrive on the script ports: finding their end, and telling ur-rtde's from any other.

The control program of ur-rtde is recognised and emulated (`control_loop.py`). Of any other program only the
lines `movel(p[...])` and `sleep(...)` are carried out (`other_program.py`).
"""

import re
from dataclasses import dataclass

from drivers.errors import InputError

LONGEST_PROGRAM = 1_000_000
_OPENING = re.compile(r"(def|thread|sec|if|while|for)\b.*:\s*(#.*)?$")
_OFFSET = re.compile(r"reg_offset_float\s*=\s*#[^\n]*\n\s*(\d+)")


@dataclass(frozen=True, slots=True)
class ControlProgram:
    """The control program of ur-rtde. offset: the first register that it uses."""

    offset: int = 0


@dataclass(frozen=True, slots=True)
class OtherProgram:
    """Any other program: its lines, stripped, without comments and empty lines."""

    lines: tuple[str, ...]


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


def recognise(text: str) -> ControlProgram | OtherProgram:
    """Distinguish ur-rtde's control program from any other program."""
    offset = _OFFSET.search(text)
    if offset is not None:
        return ControlProgram(int(offset[1]))
    lines = (line.split("#")[0].strip() for line in text.split("\n"))
    return OtherProgram(tuple(line for line in lines if line))
