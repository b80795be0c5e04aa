"""Reading a session's lines back: all of them, or those that can be read."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from drivers.errors import SessionError
from rig.sessions.codec import Codec
from rig.sessions.files import complete_lines
from rig.sessions.layout import RESULTS
from rig.sessions.records import LIFTS, POSES, FinishedLift, LiftRow, PoseRow, finished

Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class DamagedLine:
    """A line that is no record. number: from 1. problem: which key, and why."""

    number: int
    problem: str


def read_rows(path: Path, codec: Codec[Record]) -> list[Record]:
    """Read a file of lines; one cut short at the very end is left out, a file that is not there is empty.

    Raises `SessionError` naming the line and the key where one before the end is damaged.
    """
    rows, damaged = readable_rows(path, codec)
    for line in damaged:
        raise SessionError(
            f"{path}: line {line.number} is damaged: {line.problem}; move the session aside or remove that "
            "line"
        )
    return rows


def readable_rows(path: Path, codec: Codec[Record]) -> tuple[list[Record], list[DamagedLine]]:
    """Read what can be read of a file of lines, and say what cannot. Raises `SessionError` as a whole."""
    rows: list[Record] = []
    damaged: list[DamagedLine] = []
    for number, text in enumerate(complete_lines(path), start=1):
        try:
            rows.append(codec.parsed(text))
        except ValueError as error:
            damaged.append(DamagedLine(number, str(error)))
    return rows, damaged


def read_lifts(folder: Path) -> list[LiftRow]:
    """Read all attempts at a trial's lifts. Raises `SessionError`."""
    return read_rows(folder / RESULTS["trial"], LIFTS)


def read_finished_lifts(folder: Path) -> list[FinishedLift]:
    """Read a trial's lifts that count. Raises `SessionError`, also where there is none."""
    rows = finished(read_lifts(folder))
    if not rows:
        raise SessionError(f"{folder}: no finished lift; run the trial with --resume first")
    return rows


def read_poses(folder: Path) -> list[PoseRow]:
    """Read all attempts at a recording's poses. Raises `SessionError`."""
    return read_rows(folder / RESULTS["record"], POSES)
