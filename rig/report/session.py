"""Reading a session for a report: whatever of it can still be read, and what cannot."""

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RigError, SessionError
from protocols.observer import Phase
from rig.report.curves import Curve, LiftCurves
from rig.report.parts import Notice, joined
from rig.sessions.layout import TIMING
from rig.sessions.reading import recorded_values
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC, slip_topic

UNREADABLE = (
    RigError, KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, MemoryError,
    struct.error, DecodeError,
)  # fmt: skip
"""What damaged bytes lead to, beside the errors that the readers know."""
_LIFT_KEYS = {"number", "attempt", "object", "name", "lift", "accepted", "outcome", "bench_s", "recording"}
_RESULT_KEYS = {
    "re",
    "re_b",
    "re_held",
    "answered",
    "final_truth_deg",
    "phases_s",
    "frames",
    "dropped",
    "states",
}
_POSE_KEYS = {"pose", "attempt", "accepted", "position", "orientation_deg", "rejected_frames", "images"}


@dataclass(frozen=True, slots=True, eq=False)
class Lift:
    """An accepted lift: its row of `lifts.jsonl`, and its curves where the recording can be read."""

    row: dict[str, Any]
    curves: LiftCurves | None

    @property
    def name(self) -> str:
        """Name for people, as "wrench, lift 3"."""
        return lift_name(self.row)

    @property
    def zero_ns(self) -> int:
        """Start of phase B by the recording's clock."""
        return round(self.row["phases_s"][Phase.LIFT] * NS_PER_S)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A trial as far as it can be read. rows: all attempts; problems: what could not be read."""

    folder: Path
    manifest: dict[str, Any]
    rows: list[dict[str, Any]]
    lifts: list[Lift]
    timing: list[dict[str, Any]]
    problems: list[Notice]


def lift_name(row: dict[str, Any]) -> str:
    """Name of a lift for people."""
    return f"{row['name']}, lift {row['lift']}"


def object_label(row: dict[str, Any]) -> str:
    """Id and name of a lift's object."""
    return f"{row['object']} {row['name']}"


def read_trial(folder: Path, manifest: dict[str, Any]) -> Trial:
    """Read the lifts of a trial; what is damaged is named and left out."""
    rows, problems = read_rows(folder / "lifts.jsonl", usable_lift)
    timing = read_timing(folder)
    lifts, damaged = [], []
    for row in sorted((r for r in rows if r["accepted"]), key=lambda r: r["number"]):
        try:
            curves = read_curves(folder, row, manifest)
        except UNREADABLE as error:
            curves = None
            damaged.append(f"{lift_name(row)} ({row['recording']}: {_why(error)})")
        lifts.append(Lift(row, curves))
    if damaged:
        what = f"{len(damaged)} of {len(lifts)} recordings cannot be read: {joined(damaged)}."
        advice = (
            "Their results count in the tables, their curves and frames are missing below. Copy the session "
            "again from the rig's disk, or repeat these lifts."
        )
        problems.append(Notice("bad", what, advice))
    return Trial(folder, manifest, rows, lifts, timing, problems)


def find_lift(folder: Path, manifest: dict[str, Any], wanted: str) -> Lift:
    """Find an accepted lift by its number in the session ("3"), or by object and lift ("t1/3", "wrench/3").

    Raises `SessionError` for another kind of session, or a recording that cannot be read,
    `InputError` with the lifts there are for one that is not there.
    """
    if manifest.get("kind") != "trial":
        raise SessionError(f"{folder}: is a '{manifest.get('kind')}' session; only trials have lifts")
    rows, _ = read_rows(folder / "lifts.jsonl", usable_lift)
    rows = sorted((row for row in rows if row["accepted"]), key=lambda row: row["number"])
    for row in rows:
        names = {str(row["number"]), f"{row['object']}/{row['lift']}", f"{row['name']}/{row['lift']}"}
        if wanted.strip() in names:
            try:
                return Lift(row, read_curves(folder, row, manifest))
            except UNREADABLE as error:
                raise SessionError(f"{folder / row['recording']}: cannot be read ({_why(error)})") from error
    there = joined([f"{row['number']} ({row['object']}/{row['lift']} {row['name']})" for row in rows], 6)
    raise InputError(f"{folder}: no finished lift '{wanted}'; there are {there or 'none'}")


def read_rows(
    path: Path, usable: Callable[[dict[str, Any]], bool]
) -> tuple[list[dict[str, Any]], list[Notice]]:
    """Return the usable rows of a file of JSON lines, and a notice where some are not.

    usable: tells whether a row holds what is needed of it. A last line without an end is a
    write in progress or a crash, and simply left out.
    """
    try:
        lines = path.read_bytes().split(b"\n")[:-1]
    except OSError as error:
        advice = "Nothing was finished yet, or the file was lost: see log.txt in the session."
        return [], [Notice("bad", f"{path.name} cannot be read ({error.strerror}).", advice)]
    rows, bad = [], []
    for number, line in enumerate(lines, start=1):
        row = _parsed(line)
        if row is not None and usable(row):
            rows.append(row)
        else:
            bad.append(str(number))
    if not bad:
        return rows, []
    what = f"{path.name}: {len(bad)} of {len(lines)} lines are damaged (line {joined(bad)})."
    advice = (
        "They are left out of every figure. Copy the file again from the rig's disk, or remove those lines."
    )
    return rows, [Notice("bad", what, advice)]


def read_timing(folder: Path) -> list[dict[str, Any]]:
    """The usable rows of a trial's `timing.jsonl`; none where it is missing."""
    return read_rows(folder / TIMING, lambda row: isinstance(row.get("stages"), dict))[0]


def usable_pose(row: dict[str, Any]) -> bool:
    """Whether a row of `poses.jsonl` holds what a report shows."""
    return row.keys() >= _POSE_KEYS and isinstance(row["images"], list)


def read_curves(folder: Path, row: dict[str, Any], manifest: dict[str, Any]) -> LiftCurves:
    """Read a lift's curves from its recording. Raises `SessionError` and others of `UNREADABLE`."""
    path = folder / row["recording"]
    zero_s = float(row["phases_s"][Phase.LIFT])
    estimate, truth = _curve(path, FUSED_TOPIC, zero_s), _curve(path, TRUTH_TOPIC, zero_s)
    if not estimate.time_s.size or not truth.time_s.size:
        raise SessionError(f"{path}: the recording is damaged: it holds no angles")
    return LiftCurves(
        name=lift_name(row),
        estimate=estimate,
        truth=truth,
        phases_s={name: float(t) - zero_s for name, t in row["phases_s"].items()},
        onset_truth_s=row.get("onset_truth_s"),
        onset_estimate_s=row.get("onset_estimate_s"),
        tips={serial: _curve(path, slip_topic(serial), zero_s) for serial in manifest.get("signs", {})},
    )


def _curve(path: Path, topic: str, zero_s: float) -> Curve:
    ordered = sorted(recorded_values(path, topic), key=lambda v: v["time_ns"])

    def column(key: str) -> np.ndarray:
        return np.array([np.nan if v.get(key) is None else v[key] for v in ordered], float)

    times = np.array([v["time_ns"] / NS_PER_S - zero_s for v in ordered], float)
    return Curve(times, column("angle_deg"), column("sigma_deg"), tuple(v["state"] for v in ordered))


def usable_lift(row: dict[str, Any]) -> bool:
    """Whether a row of `lifts.jsonl` holds what a report shows."""
    needed = _LIFT_KEYS | (_RESULT_KEYS if row.get("accepted") else set())
    return row.keys() >= needed


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def _why(error: BaseException) -> str:
    """The error without the path, which stands beside it."""
    if not isinstance(error, RigError):
        return f"damaged: {type(error).__name__} {error}".strip()
    return (str(error).partition(".mcap: ")[2] or str(error)).removeprefix("the recording is ")


def curves_of(lifts: Sequence[Lift]) -> list[LiftCurves]:
    """The curves of the lifts that have them."""
    return [lift.curves for lift in lifts if lift.curves is not None]
