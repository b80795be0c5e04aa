"""Capture times of frames, from a table or from a frame rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePath

from drivers.clock import NS_PER_S
from drivers.errors import FormatError, InputError
from drivers.formats import parse_time_ns, parse_whole, read_csv_rows, shown, time_ns_in

MAX_FPS = 10_000.0


@dataclass(frozen=True, slots=True)
class FrameTime:
    """A frame's time: the user's text, in s, and the same time in integer ns."""

    text: str
    time_ns: int


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    frame: str
    time: FrameTime


def times_at_rate(count: int, fps: float) -> list[FrameTime]:
    """Return the times of `count` frames at a rate in Hz, from 0 on. Raises `InputError` for a bad rate."""
    if not 0 < fps <= MAX_FPS:
        raise InputError(f"{fps:g} Hz is not a frame rate: give one above 0 and up to {MAX_FPS:g}")
    return [FrameTime(f"{i / fps:.6f}", round(i / fps * NS_PER_S)) for i in range(count)]


def times_from_table(table: Path, names: Sequence[str]) -> list[FrameTime]:
    """Return the times of the frames with these names from a CSV with columns `frame` and `t_s`.

    A row names its frame by file name, with or without ending, or by its number from 0. Numbers must be used
    in all rows or in none. Each frame needs exactly one row; rows are in the frames' order, and times never
    go back. Raises `InputError` naming the line otherwise.
    """
    rows = _rows(table)
    places = _places(table, rows, names)
    for (place, row), (next_place, next_row) in pairwise(zip(places, rows, strict=True)):
        if next_place < place or next_row.time.time_ns < row.time.time_ns:
            later, line = f"{table}: line {next_row.line}", row.line
            raise InputError(
                f"{later} comes before line {line} in time or in the frames' order: sort the rows"
            )
    if len(places) < len(names):
        missing = names[min(set(range(len(names))) - set(places))]
        raise InputError(f"{table}: line {rows[-1].line} is the last and '{missing}' has no row: add one")
    return [row.time for row in rows]


def parse_time(text: str) -> FrameTime:
    """Parse a time in s, exact to the ns. Raises `FormatError` that begins with the text."""
    return FrameTime(text.strip(), parse_time_ns(text))


def _rows(table: Path) -> list[_Row]:
    rows = [_row(table, line, fields) for line, fields in read_csv_rows(table, ("frame", "t_s"))]
    if not rows:
        raise InputError(f"{table}: line 2 is missing: give one row per frame")
    return rows


def _row(table: Path, line: int, fields: dict[str, str]) -> _Row:
    time = FrameTime(fields["t_s"], time_ns_in(fields, "t_s", f"{table}: line {line}"))
    if not fields["frame"]:
        raise InputError(f"{table}: line {line}: the frame is missing: give its file name or number")
    return _Row(line, fields["frame"], time)


def _places(table: Path, rows: Sequence[_Row], names: Sequence[str]) -> list[int]:
    """Return the index of the frame that each row names."""
    known = _by_name(names)
    numbered = not any(row.frame in known for row in rows)
    seen: dict[int, int] = {}
    for row in rows:
        place = _number_of(row.frame, len(names)) if numbered else known.get(row.frame)
        if place is None:
            raise InputError(
                f"{table}: line {row.line}: there is no frame {shown(row.frame)}: remove the row"
            )
        if place in seen:
            raise InputError(
                f"{table}: line {row.line}: {shown(row.frame)} is on line {seen[place]} already: keep one"
            )
        seen[place] = row.line
    return list(seen)


def _number_of(text: str, count: int) -> int | None:
    """Return the number of a frame, also if it is written as 2.0e+00; None if there is no such frame."""
    try:
        number = parse_whole(text)
    except FormatError:
        return None
    return number if 0 <= number < count else None


def _by_name(names: Sequence[str]) -> dict[str, int]:
    """Map file names to indices; also stems, if only one file has that stem."""
    stems = [PurePath(name).stem for name in names]
    unique = {stem: i for i, stem in enumerate(stems) if stems.count(stem) == 1}
    return {**unique, **{name: i for i, name in enumerate(names)}}
