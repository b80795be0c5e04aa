"""Capture times of a stream of frames: the only place that decides what its times mean.

Times come from a table, a frame rate, a video's container, the stamps of a ROS bag, or the caller. There are
three verdicts on them: they are used as they are; they are replaced, with a note; or they are refused
(`InputError`) because they stay ambiguous. The times of a live stream, of which only the past is known, are
checked frame by frame in `drivers.tally.StreamTimes`.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path, PurePath

import numpy as np
from numpy.typing import NDArray

from calibration.bursts import spread_bursts
from drivers.clock import NS_PER_S
from drivers.errors import FormatError, InputError, plural
from drivers.formats import (
    MOST_CSV_BYTES,
    CsvTable,
    parse_csv,
    parse_time_ns,
    parse_whole,
    quote,
    read_csv,
    read_text,
    time_ns_in,
)
from drivers.tally import LONGEST_STEP_NS
from rig.frames.clips import ABOUT
from rig.sessions.recorder import seconds_text

LEAST_FPS, MAX_FPS = 0.02, 2000.0
"""Frame rates in Hz of a tactile sensor; times with another rate are in another unit than s."""
APART_S = LONGEST_STEP_NS / NS_PER_S
"""Frames further apart than this, s, are noted: much can happen between them."""
MOST_REPEATED = 0.5
"""If more than this share of the frames has the time of the frame before, irregularly, the times are too
coarse."""
_UNITS = {"ms": 1e3, "microseconds": 1e6, "ns": 1e9, "minutes": 1 / 60, "hours": 1 / 3600}
USUAL_FPS = 1.0, 500.0
_TIME_IN_NAME = re.compile(r"(?<![0-9.])(?:[0-9]+\.[0-9]+|[0-9]{13}|[0-9]{16}|[0-9]{19})(?![0-9.])")
_SINCE_1970 = {13: "ms", 16: "microseconds", 19: "ns"}
"""Units of the time since 1970 by number of digits, from 2001 to 2286."""
MOST_DRIFT, LEAST_DRIFT_S = 0.05, 0.2
"""Stamps and times of receipt whose durations differ by more than this share, and time in s, are those of two
clocks. Frames may arrive in bursts, so the durations of short streams differ."""
_A_DAY_NS = 86_400 * NS_PER_S
"""Frames further apart than this have times of two clocks, as 0 and the seconds since 1970."""
Times = NDArray[np.int64]


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
    if not LEAST_FPS <= fps <= MAX_FPS:
        raise InputError(f"{fps:g} Hz is not a frame rate: give one from {LEAST_FPS:g} to {MAX_FPS:g}")
    return [FrameTime(f"{i / fps:.6f}", round(i / fps * NS_PER_S)) for i in range(count)]


def check_times(where: str, times_ns: Sequence[int] | Times) -> tuple[Times, tuple[str, ...]]:
    """Return the times of a stream as they are used, ns, and notes on them; the same for all sources.

    where: the stream's name in errors. times_ns: in the order of the frames. Times that are shared by regular
    bursts of frames are spread, see `spread_bursts`. Raises `InputError` if the times go back, if most frames
    share their time irregularly, if frames are days apart, or for a unit that cannot be s.
    """
    given = np.asarray(times_ns, np.int64)
    steps = np.diff(given)
    if (steps < 0).any():
        frame = int(np.argmax(steps < 0)) + 1
        back_s = -steps[frame - 1] / NS_PER_S
        raise InputError(
            f"{where}: frame {frame} is {back_s:g} s before the previous frame: give times that are not "
            "decreasing (sort the frames), or a frame rate instead (--fps)"
        )
    if steps.size == 0:
        return given, ()
    repeated = np.flatnonzero(steps == 0) + 1
    times, burst_s = (repeated.size and spread_bursts(given)) or (given, 0.0)
    steps = np.diff(times)
    if (steps == 0).sum() > MOST_REPEATED * len(times) or not steps.any() or burst_s > APART_S:
        raise InputError(
            f"{where}: {repeated.size} of {len(times)} frames have the time of the previous frame (first: "
            f"frame {repeated[0]}): times in whole seconds, or rounded as float32? Give finer times, or a "
            "frame rate (--fps)"
        )
    if (far := np.flatnonzero(steps > _A_DAY_NS)).size:
        raise InputError(
            f"{where}: frame {far[0] + 1} is {steps[far[0]] / _A_DAY_NS:.3g} days after the previous frame: "
            "was the clock set, or was a time not known? Correct the times, or give a frame rate (--fps)"
        )
    step_s = float(np.median(steps[steps > 0])) / NS_PER_S
    if not LEAST_FPS <= 1.0 / step_s <= USUAL_FPS[1]:
        raise InputError(
            f"{where}: {1.0 / step_s:.3g} frames per second by their times, {step_s:.3g} s apart: "
            f"{ask_unit(step_s)} Give times in s, or a frame rate (--fps)"
        )
    if burst_s:
        return times, (f"times: frames share one time every {burst_s:.3g} s: spread since the one before",)
    if repeated.size == 0:
        return times, ()
    return times, (
        f"times: {plural(repeated.size, 'frame')} with the time of the previous frame (first: frame "
        f"{repeated[0]}): not estimated, 'lost'",
    )


GAP_STEPS = 2.5
"""A step of more than this many median steps is a gap: at least two frames are missing."""


def spacing_notes(times_ns: Sequence[int] | Times) -> list[str]:
    """Return notes on a stream whose frames are more than `APART_S` apart, and on its gaps.

    Gaps are steps of more than `GAP_STEPS` median ones.
    """
    times = np.asarray(times_ns, np.int64)
    steps, notes = np.diff(times) / NS_PER_S, list[str]()
    step_s = float(np.median(steps)) if steps.size else 0.0
    if step_s > APART_S:
        notes.append(
            f"the frames are {step_s:.3g} s apart ({ask_unit(step_s)}): a rotation by more than a quarter "
            "turn between two frames cannot be recognised"
        )
    if (gaps := np.flatnonzero(steps > GAP_STEPS * step_s)).size:
        longest = gaps[steps[gaps].argmax()]
        after_s = (times[longest] - times[0]) / NS_PER_S
        notes.append(
            f"{plural(len(gaps), 'gap')} between the frames, the longest {steps[longest]:.3g} s, "
            f"{after_s:.3f} s after the first frame"
        )
    return notes


def replace_times(times: Sequence[FrameTime], used_ns: Times) -> list[FrameTime]:
    """Return times with those that are used in their place; an unchanged one keeps its text."""
    return [
        time if time.time_ns == used else FrameTime(seconds_text(used), used)
        for time, used in zip(times, used_ns.tolist(), strict=True)
    ]


def stamped_times(
    where: str, stamps_ns: Sequence[int], received_ns: Sequence[int]
) -> tuple[Times, list[str]]:
    """Return the times of received frames, ns, and notes: their stamps, or the times of receipt.

    where: the stream's name in errors. Stamps are used if they can be sorted: frames that overtook others by
    at most `APART_S` are sorted later by their time. Stamps that are missing, constant, rounded or set back
    are replaced by the times of receipt. Raises `InputError` if these cannot be used either.
    """
    stamps, received = np.asarray(stamps_ns, np.int64), np.asarray(received_ns, np.int64)
    back = int((np.diff(stamps) < 0).sum())
    if not stamps[:2].any():
        why = "no stamps"
    elif (np.maximum.accumulate(stamps) - stamps > LONGEST_STEP_NS).any():
        why = "stamps that go back"
    else:
        try:
            used, more = _check_sorted(where, stamps)
            notes = [f"times: {plural(back, 'frame')} arrived out of order, sorted by stamp"] if back else []
            return used, [*notes, *_compare_clocks(stamps, received), *more]
        except InputError:
            why = "stamps that are constant, rounded or not in s, or days apart"
    note = f"times: of receipt, because the frames have {why}"
    used, more = _check_sorted(f"{where}, {note}", received)
    return used, [note, *more]


def _check_sorted(where: str, times: Times) -> tuple[Times, tuple[str, ...]]:
    """Check times in another order than that of the frames, see `check_times`."""
    order, used = np.argsort(times, kind="stable"), np.empty_like(times)
    used[order], notes = check_times(where, times[order])
    return used, notes


def _compare_clocks(stamps: Times, received: Times) -> list[str]:
    """Return a warning if the stamps run at another speed than the clock of the receiver."""
    spans_s = by_stamps_s, received_s = [float(np.ptp(times)) / NS_PER_S for times in (stamps, received)]
    if abs(by_stamps_s - received_s) <= max(MOST_DRIFT * max(spans_s), LEAST_DRIFT_S):
        return []
    return [
        f"warning: {by_stamps_s:.3g} s by the stamps, which are used, and {received_s:.3g} s by the times of "
        "receipt: was the bag played at another speed?"
    ]


def container_times(
    where: str, shown_ns: Sequence[int], fps: float
) -> tuple[list[FrameTime], tuple[str, ...]]:
    """Return the times of a video's frames, and notes.

    shown_ns: presentation time of each frame, 0 where the container has none. fps: the container's nominal
    rate, which is used if no presentation time contradicts it, since many containers round times to ms. In a
    video of variable rate the presentation times count from the first frame. Raises `InputError`.
    """
    shown_at = np.asarray(shown_ns, np.int64) - shown_ns[0]
    given = np.concatenate([[True], shown_at[1:] > np.maximum.accumulate(shown_at)[:-1]])
    nominal = np.arange(len(shown_at)) * NS_PER_S / max(fps, 1e-9)
    if not given[1:].any() or (abs(shown_at - nominal)[given] <= 0.5 * NS_PER_S / max(fps, 1e-9)).all():
        return times_at_rate(len(shown_at), fps), ()
    notes = [f"times: of the video's container, which are not those of {fps:g} frames per second"]
    if missing := int((~given).sum()):
        notes.append(f"times: {plural(missing, 'frame')} without a time, interpolated")
    found = [
        FrameTime(f"{time / NS_PER_S:.6f}", round(time))
        for time in _fill(shown_at, given, NS_PER_S / max(fps, 1e-9)).tolist()
    ]
    used, more = check_times(where, [time.time_ns for time in found])
    return replace_times(found, used), (*notes, *more)


def _fill(times: Times, given: NDArray[np.bool_], step_ns: float) -> NDArray[np.float64]:
    """Return times with the missing ones interpolated, and continued after the last at the median step.

    step_ns: used in place of the median step if only the first time is given.
    """
    places, known = np.arange(len(times)), np.flatnonzero(given)
    found = np.interp(places, known, times[given])
    steps = np.diff(found[: known[-1] + 1])
    return found + np.maximum(places - known[-1], 0) * (np.median(steps) if steps.size else step_ns)


def ask_unit(step_s: float) -> str:
    """Return the question whether times are in another unit, in which the rate would be usual."""
    low, high = USUAL_FPS
    guess = next((unit for unit, factor in _UNITS.items() if low <= factor / step_s <= high), "another unit")
    return f"are the times in {guess}?"


def times_in_names(names: Sequence[str]) -> tuple[list[FrameTime], str] | None:
    """Return the times that the names of frames consist of, and a note with their unit; None if they do not.

    These are decimal numbers of s, some with at least three decimals, or ms, microseconds or ns since 1970.
    They increase, at a usual frame rate.
    """
    texts = [text for name in names for text in _TIME_IN_NAME.findall(PurePath(name).stem)]
    digits = {len(text) for text in texts if "." not in text}
    unit = _SINCE_1970.get(min(digits, default=0), "s")
    if len(names) < 2 or len(texts) != len(names) or len(digits) > 1:
        return None
    if unit == "s" and (digits or max(len(text.partition(".")[2]) for text in texts) < 3):
        return None
    times_ns = [round(Decimal(text) * NS_PER_S / round(_UNITS.get(unit, 1))) for text in texts]
    rate = NS_PER_S / max(float(np.median(np.diff(times_ns))), 1.0)
    if min(np.diff(times_ns)) <= 0 or not USUAL_FPS[0] <= rate <= USUAL_FPS[1]:
        return None
    note = f"times: those in the names, in {unit}, {rate:.3g} frames per second; --fps sets others"
    return [FrameTime(seconds_text(time_ns), time_ns) for time_ns in times_ns], note


def times_from_table(table: Path, names: Sequence[str]) -> list[FrameTime]:
    """Return the times of the frames with these names from a CSV with columns `frame` and `t_s`.

    A row names its frame by file name, with or without ending, or by its number from 0. Numbers must be used
    in all rows or in none. Each frame needs exactly one row; rows are in the frames' order, and times never
    go back. Raises `InputError` naming the line otherwise.
    """
    rows = _rows(table, read_csv(table, ("frame", "t_s")))
    if not rows:
        raise InputError(f"{table}: line 2 is missing: give one row per frame")
    places = _places(table, rows, names)
    if len(places) < len(names):
        missing = names[min(set(range(len(names))) - set(places))]
        raise InputError(f"{table}: line {rows[-1].line} is the last and '{missing}' has no row: add one")
    return [row.time for row in rows]


def clip_times(table: Path, names: Sequence[str], fps: float) -> tuple[list[FrameTime], list[str]]:
    """Return the times of a clip's frames from its own table, and notes; a recording may be interrupted.

    names: of the frames, see `times_from_table`. Rows without a frame are ignored. Frames without a row get
    interpolated times, and after the last row times at the median step; without rows, times at `fps` in Hz.
    Raises `InputError` for a table that is invalid otherwise, and if the first frame has no row.
    """
    rows, known = _recorded_rows(table), _by_name(names)
    if not rows:
        return times_at_rate(len(names), fps), [f"{table}: has no times: {fps:g} frames per second assumed"]
    kept = [row for row in rows if row.frame in known] or rows
    places = _places(table, kept, names)
    gone = len(rows) - len(kept)
    notes = [f"{table}: {plural(gone, 'row')} without a frame, ignored"] if gone else []
    if len(places) == len(names):
        return [row.time for row in kept], notes
    if places[0] != 0:
        raise InputError(f"{table}: line {kept[0].line} is the first and '{names[0]}' has no row: add one")
    given, times = np.zeros(len(names), bool), np.zeros(len(names), np.int64)
    given[places], times[places] = True, [row.time.time_ns for row in kept]
    filled = _fill(times, given, NS_PER_S / fps).tolist()
    found = [FrameTime(f"{time / NS_PER_S:.9f}", round(time)) for time in filled]
    for place, row in zip(places, kept, strict=True):
        found[place] = row.time
    missing = f"{len(names) - len(kept)} of {plural(len(names), 'frame')} have no time"
    return found, [*notes, f"{table}: {missing} (interrupted?): it is computed from the times of the others"]


def _recorded_rows(table: Path) -> list[_Row]:
    """Return the rows of a clip's table; none for a table without a complete header.

    The last line of a table that `rig live` has written is not complete if it has no end.
    """
    text = read_text(table, MOST_CSV_BYTES)
    if table.with_name(ABOUT).exists():
        text = text[: text.rfind("\n") + 1]
    if not text.strip():
        return []
    found = parse_csv(text, str(table))
    found.require("frame", "t_s")
    return _rows(table, found)


def parse_time(text: str) -> FrameTime:
    """Parse a time in s, exact to the ns. Raises `FormatError` that begins with the text."""
    return FrameTime(text.strip(), parse_time_ns(text))


def _rows(table: Path, found: CsvTable) -> list[_Row]:
    rows = []
    for line, fields in found.rows():
        time = FrameTime(fields["t_s"], time_ns_in(fields, "t_s", f"{table}: line {line}"))
        if not fields["frame"]:
            raise InputError(f"{table}: line {line}: the frame is missing: give its file name or number")
        rows.append(_Row(line, fields["frame"], time))
    return rows


def _places(table: Path, rows: Sequence[_Row], names: Sequence[str]) -> list[int]:
    """Return the index of the frame that each row names. Raises `InputError` unless rows are in order."""
    known = _by_name(names)
    numbered = not any(row.frame in known for row in rows)
    seen: dict[int, int] = {}
    for row in rows:
        place = known.get(row.frame)
        if numbered:
            with suppress(FormatError):  # a number may also be written as 2.0e+00
                place = parse_whole(row.frame)
                place = place if 0 <= place < len(names) else None
        if place is None:
            raise InputError(
                f"{table}: line {row.line}: there is no frame {quote(row.frame)}: remove the row"
            )
        if place in seen:
            raise InputError(
                f"{table}: line {row.line}: {quote(row.frame)} is on line {seen[place]} already: keep one"
            )
        seen[place] = row.line
    for (place, row), (next_place, next_row) in pairwise(zip(seen, rows, strict=True)):
        if next_place < place or next_row.time.time_ns < row.time.time_ns:
            later, line = f"{table}: line {next_row.line}", row.line
            raise InputError(
                f"{later} comes before line {line} in time or in the frames' order: sort the rows"
            )
    return list(seen)


def _by_name(names: Sequence[str]) -> dict[str, int]:
    """Map file names to indices; also stems, if only one file has that stem."""
    stems = [PurePath(name).stem for name in names]
    unique = {stem: i for i, stem in enumerate(stems) if stems.count(stem) == 1}
    return {**unique, **{name: i for i, name in enumerate(names)}}
