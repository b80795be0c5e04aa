"""What a trial amounts to: the paper's table per object and MARE, with intervals."""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Protocol

from rig.results.metrics import Mare, mare
from rig.sessions.codec import json_value
from rig.sessions.records import ErrorSummary, LiftRow, finished

CSV_COLUMNS = (
    "number", "attempt", "object", "name", "lift", "position", "accepted", "outcome", "fault",
    "grip_counts", "lift_height_m", "final_estimate_deg", "final_truth_deg", "onset_truth_s",
    "onset_estimate_s", "answered", "bench_s", "recording",
)  # fmt: skip
ERRORS = ("re_b", "re", "re_held")
"""A lift's errors: over phase B, over B and C, over both with refused frames held."""


class MeasuredLift(Protocol):
    """What a summary needs of a lift, from a session or from a table of many; see `LiftFigures`."""

    @property
    def object(self) -> str:
        """Its object's id."""
        ...

    @property
    def name(self) -> str:
        """Its object's name."""
        ...

    @property
    def outcome(self) -> str:
        """How it ended."""
        ...

    @property
    def re_b(self) -> ErrorSummary | None:
        """Error over phase B."""
        ...

    @property
    def re(self) -> ErrorSummary | None:
        """Error over phases B and C."""
        ...

    @property
    def re_held(self) -> ErrorSummary | None:
        """Error with refused frames held."""
        ...

    @property
    def answered(self) -> float:
        """Share of frames answered."""
        ...

    @property
    def final_truth_deg(self) -> float | None:
        """True turn."""
        ...


@dataclass(frozen=True, slots=True)
class ObjectSummary:
    """One object's row of the table: lifts, outcomes, and MARE over B, over B and C, and held."""

    object_id: str
    name: str
    lifts: int
    outcomes: dict[str, int]
    mare_b: Mare | None
    mare: Mare | None
    answered: float
    turn_deg: tuple[float, float]


@dataclass(frozen=True, slots=True)
class TrialSummary:
    """The whole trial."""

    objects: tuple[ObjectSummary, ...]
    lifts_accepted: int
    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    answered: float
    bench_s: float
    turns_deg: tuple[float, ...]


def summarize_trial(rows: Sequence[LiftRow]) -> TrialSummary:
    """Summarize the accepted lifts of a session's rows; faults count in none of the figures."""
    return summarize_lifts(finished(rows), sum(row.bench_s for row in rows))


def summarize_lifts(lifts: Sequence[MeasuredLift], bench_s: float) -> TrialSummary:
    """Summarize lifts. bench_s: how long they and failed attempts took by the bench's clock."""
    ids = list(dict.fromkeys(lift.object for lift in lifts))
    return TrialSummary(
        objects=tuple(_object_summary([lift for lift in lifts if lift.object == i]) for i in ids),
        lifts_accepted=len(lifts),
        mare=mare_of(lift.re for lift in lifts),
        mare_b=mare_of(lift.re_b for lift in lifts),
        mare_held=mare_of(lift.re_held for lift in lifts),
        answered=_mean([lift.answered for lift in lifts]),
        bench_s=bench_s,
        turns_deg=_turns(lifts),
    )


def mare_of(errors: Iterable[ErrorSummary | None]) -> Mare | None:
    """Return the MARE over lifts' errors; lifts without an answer do not count."""
    known = [error for error in errors if error is not None]
    return mare([error.mean_deg for error in known], [error.std_deg for error in known])


def lifts_csv(rows: Sequence[LiftRow]) -> str:
    """Return the lifts as CSV text, one line per attempt, errors in degrees."""
    text = io.StringIO()
    errors = [f"{part}_{key}" for part in ERRORS for key in ("mean_deg", "std_deg", "max_deg")]
    writer = csv.DictWriter(
        text, [*CSV_COLUMNS, *errors], restval="", extrasaction="ignore", lineterminator="\n"
    )
    writer.writeheader()
    for row in rows:
        writer.writerow({**json_value(row), **flat_errors(row)})
    return text.getvalue()


def flat_errors(row: LiftRow) -> dict[str, float | int]:
    """Return a lift's errors by part and key, as `re_b_mean_deg`; nothing for parts without an answer."""
    parts = {part: getattr(row, part, None) for part in ERRORS}
    return {
        f"{part}_{key}": value
        for part, error in parts.items()
        if error is not None
        for key, value in asdict(error).items()
    }


def _object_summary(lifts: Sequence[MeasuredLift]) -> ObjectSummary:
    turns = _turns(lifts)
    return ObjectSummary(
        object_id=lifts[0].object,
        name=lifts[0].name,
        lifts=len(lifts),
        outcomes=dict(Counter(str(lift.outcome) for lift in lifts)),
        mare_b=mare_of(lift.re_b for lift in lifts),
        mare=mare_of(lift.re for lift in lifts),
        answered=_mean([lift.answered for lift in lifts]),
        turn_deg=(min(turns, default=0.0), max(turns, default=0.0)),
    )


def _turns(lifts: Sequence[MeasuredLift]) -> tuple[float, ...]:
    """Final true angles of the lifts that have one, deg."""
    return tuple(lift.final_truth_deg for lift in lifts if lift.final_truth_deg is not None)


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
