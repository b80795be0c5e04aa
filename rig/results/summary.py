"""What a trial amounts to: the paper's table per object and MARE, with intervals."""

import csv
import io
from dataclasses import dataclass
from typing import Any

from rig.results.metrics import Mare, mare

CSV_COLUMNS = (
    "number", "attempt", "object", "name", "lift", "position", "accepted", "outcome", "fault",
    "grip_counts", "lift_height_m", "final_estimate_deg", "final_truth_deg", "onset_truth_s",
    "onset_estimate_s", "answered", "bench_s", "recording",
)  # fmt: skip


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


def summarize_trial(rows: list[dict[str, Any]]) -> TrialSummary:
    """Summarize the accepted lifts of a session's rows; faults count in none of the figures."""
    accepted = [row for row in rows if row["accepted"]]
    ids = list(dict.fromkeys(row["object"] for row in accepted))
    return TrialSummary(
        objects=tuple(_object_summary([r for r in accepted if r["object"] == i]) for i in ids),
        lifts_accepted=len(accepted),
        mare=_mare(accepted, "re"),
        mare_b=_mare(accepted, "re_b"),
        mare_held=_mare(accepted, "re_held"),
        answered=_mean([row["answered"] for row in accepted]),
        bench_s=sum(row["bench_s"] for row in rows),
        turns_deg=_turns(accepted),
    )


def lifts_csv(rows: list[dict[str, Any]]) -> str:
    """Return the lifts as CSV text, one line per attempt, errors in degrees."""
    text = io.StringIO()
    errors = [
        f"{part}_{key}" for part in ("re_b", "re", "re_held") for key in ("mean_deg", "std_deg", "max_deg")
    ]
    writer = csv.DictWriter(
        text, [*CSV_COLUMNS, *errors], restval="", extrasaction="ignore", lineterminator="\n"
    )
    writer.writeheader()
    for row in rows:
        parts = {p: row.get(p) or {} for p in ("re_b", "re", "re_held")}
        flat = {f"{part}_{key}": value for part, values in parts.items() for key, value in values.items()}
        writer.writerow({**{k: "" if v is None else v for k, v in row.items()}, **flat})
    return text.getvalue()


def _object_summary(rows: list[dict[str, Any]]) -> ObjectSummary:
    outcomes: dict[str, int] = {}
    for row in rows:
        outcomes[row["outcome"]] = outcomes.get(row["outcome"], 0) + 1
    turns = _turns(rows)
    return ObjectSummary(
        object_id=rows[0]["object"],
        name=rows[0]["name"],
        lifts=len(rows),
        outcomes=outcomes,
        mare_b=_mare(rows, "re_b"),
        mare=_mare(rows, "re"),
        answered=_mean([row["answered"] for row in rows]),
        turn_deg=(min(turns, default=0.0), max(turns, default=0.0)),
    )


def _mare(rows: list[dict[str, Any]], part: str) -> Mare | None:
    known = [row[part] for row in rows if row.get(part)]
    return mare([k["mean_deg"] for k in known], [k["std_deg"] for k in known])


def _turns(rows: list[dict[str, Any]]) -> tuple[float, ...]:
    """Final true angles of the lifts that have one, deg."""
    return tuple(row["final_truth_deg"] for row in rows if row["final_truth_deg"] is not None)


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
