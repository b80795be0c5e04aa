"""Read a session for a report, as far as it is readable, with notices about damaged parts."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from google.protobuf.message import DecodeError

from drivers.errors import InputError, RigError, SessionError, plural
from rig.experiments.process_pool import run_in_order
from rig.report.parts import Notice, join_items
from rig.sessions.codec import Codec
from rig.sessions.files import RESULTS
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import read_angles
from rig.sessions.recording_file import recording_gaps
from rig.sessions.records import LIFTS, Lift, LiftTiming, accepted_lifts
from rig.sessions.rows import read_timing, readable_rows

Record = TypeVar("Record")
UNREADABLE = (
    RigError, KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, MemoryError,
    struct.error, DecodeError,
)  # fmt: skip
"""Exceptions that damaged recordings raise, in addition to those of the readers."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The readable parts of a trial. rows: all attempts. problems: notices about unreadable parts."""

    folder: Path
    manifest: TrialManifest
    rows: list[Lift]
    lifts: list[Lift]
    timing: list[LiftTiming]
    problems: list[Notice]


def read_trial(folder: Path, manifest: TrialManifest, jobs: int = 1) -> Trial:
    """Read the lifts of a trial, in `jobs` processes; damaged parts are left out and reported."""
    rows, problems = read_usable(folder / RESULTS["trial"], LIFTS)
    timing = read_timing(folder)
    done = sorted(accepted_lifts(rows), key=lambda row: row.number)
    read = list(run_in_order(partial(_read_usable, folder, manifest), done, jobs))
    lifts = [lift for lift, _ in read]
    damaged = [f"{lift.title} ({lift.recording}: {why})" for lift, why in read if why is not None]
    if damaged:
        what = f"{len(damaged)} of {plural(len(lifts), 'recording')} cannot be read: {join_items(damaged)}."
        advice = (
            "Their results are in the tables; their curves and frames are missing. Copy the session again "
            "from the rig's disk, or repeat these lifts."
        )
        problems.append(Notice("bad", what, advice))
    gaps = [(lift, lift.notes) for lift in lifts if lift.notes]
    if gaps:
        named = join_items([f"{lift.title} ({lift.recording}: {join_items(list(of))})" for lift, of in gaps])
        advice = (
            "Their results are in the tables; curves and frames are shown without the damaged parts. Copy "
            "the session again from the rig's disk, or repeat these lifts."
        )
        what = f"{len(gaps)} of {plural(len(lifts), 'recording')} are damaged in part: {named}."
        problems.append(Notice("bad", what, advice))
    return Trial(folder, manifest, rows, lifts, timing, problems)


def _read_usable(folder: Path, manifest: TrialManifest, lift: Lift) -> tuple[Lift, str | None]:
    """Return a lift with its angles, or without them and why they cannot be read."""
    try:
        return _read_lift(folder, lift, manifest), None
    except UNREADABLE as error:
        return lift, _why(error)


def _read_lift(folder: Path, lift: Lift, manifest: TrialManifest) -> Lift:
    """Read a lift's angles, skipping gaps. Raises `SessionError` and other errors of `UNREADABLE`."""
    gaps = tuple(recording_gaps(folder / lift.recording))
    return replace(read_angles(folder, lift, manifest.signs, []), notes=gaps)


def find_lift(folder: Path, manifest: TrialManifest, wanted: str | None) -> Lift:
    """Find an accepted lift by its number in the session ("3"), or by object and lift ("t1/3", "wrench/3").

    wanted: None for the first lift.

    Gaps of its recording are skipped. Raises `SessionError` for a recording that cannot be read, and
    `InputError` with the existing lifts for a missing one.
    """
    rows, problems = read_usable(folder / RESULTS["trial"], LIFTS)
    lifts = sorted(accepted_lifts(rows), key=lambda row: row.number)
    for row in lifts:
        names = {str(row.number), f"{row.object}/{row.lift}", f"{row.name}/{row.lift}"}
        if wanted is None or wanted.strip() in names:
            try:
                return _read_lift(folder, row, manifest)
            except UNREADABLE as error:
                raise SessionError(f"{folder / row.recording}: cannot be read ({_why(error)})") from error
    there = join_items([f"{row.number} ({row.object}/{row.lift} {row.name})" for row in lifts], 6)
    why = "".join(f"; {problem.what}" for problem in problems)
    which = "" if wanted is None else f" '{wanted}'"
    raise InputError(f"{folder}: no finished lift{which}; there are {there or 'none'}{why}")


def read_usable(path: Path, codec: Codec[Record]) -> tuple[list[Record], list[Notice]]:
    """Return the readable rows of a session's file, and a notice if others are damaged."""
    try:
        rows, damaged = readable_rows(path, codec)
        missing = "" if path.exists() else f"{path.name} is missing."
    except SessionError as error:
        rows, damaged, missing = [], {}, f"{error}."
    if missing:
        advice = "Nothing was finished yet, or the file was lost: see log.txt in the session."
        return [], [Notice("bad", missing, advice)]
    if not damaged:
        return rows, []
    where = join_items([f"line {number}: {problem}" for number, problem in damaged.items()])
    what = f"{path.name}: {len(damaged)} of {plural(len(damaged) + len(rows), 'line')} damaged ({where})."
    advice = "They are not in any figure. Copy the file again from the rig's disk, or remove those lines."
    return rows, [Notice("bad", what, advice)]


def _why(error: BaseException) -> str:
    """Return the text of an error without the path, which the caller shows."""
    if not isinstance(error, RigError):
        return f"damaged: {type(error).__name__} {error}".strip()
    return (str(error).partition(".mcap: ")[2] or str(error)).removeprefix("the recording is ")


def with_angles(lifts: Iterable[Lift]) -> list[Lift]:
    """Return the lifts whose recordings can be read."""
    return [lift for lift in lifts if lift.angles]
