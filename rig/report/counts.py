"""What was counted and timed in a trial, as tables."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from rig.report.parts import Table


def stage_table(timing: Sequence[dict[str, Any]]) -> Table | None:
    """Wall time per stage and frame: the middle lift's median and 95th, the worst lift's 99th percentile."""
    stages: dict[str, list[dict[str, float]]] = {}
    for row in timing:
        for name, spent in row["stages"].items():
            stages.setdefault(name, []).append(spent)
    if not stages:
        return None
    ordered = sorted(stages, key=lambda name: (name == "total", -_middle(stages[name], "p50_ms")))
    rows = [
        [
            name,
            f"{_middle(stages[name], 'p50_ms'):.2f}",
            f"{_middle(stages[name], 'p95_ms'):.2f}",
            f"{_middle(stages[name], 'p99_ms'):.2f}",
            f"{max(spent['p99_ms'] for spent in stages[name]):.2f}",
        ]
        for name in ordered
    ]
    columns = ("stage", "median, ms", "95 %, ms", "99 %, ms", "99 % in the worst lift, ms")
    return Table(columns, rows, total=True)


def counts_table(rows: Sequence[dict[str, Any]]) -> Table | None:
    """Frames received and dropped, per source."""
    frames: Counter[str] = Counter()
    dropped: Counter[str] = Counter()
    for row in rows:
        frames.update(row["frames"])
        dropped.update(row["dropped"])
    if not frames:
        return None
    cells = [[source, f"{frames[source]}", f"{dropped[source]}"] for source in frames]
    return Table(("source", "frames", "dropped"), cells)


def onset_table(rows: Sequence[dict[str, Any]]) -> Table | None:
    """How much later than the markers' onset the estimate's, and the event raised in the lift, came."""
    slipped = [row for row in rows if row.get("onset_truth_s") is not None]
    if not slipped:
        return None
    cells = []
    for name, key in (("estimated curve", "onset_estimate_s"), ("slip event", "onset_alarm_s")):
        late_ms = [(row[key] - row["onset_truth_s"]) * 1e3 for row in slipped if row.get(key) is not None]
        spread = [f"{v:+.0f}" for v in np.percentile(late_ms, [50, 5, 95])] if late_ms else ["-"] * 3
        unasked = sum(row.get(key) is not None for row in rows if row.get("onset_truth_s") is None)
        cells.append([name, f"{len(late_ms)} of {len(slipped)}", *spread, str(unasked)])
    columns = ("onset by", "slips seen", "median, ms", "5 %, ms", "95 %, ms", "in lifts without a slip")
    return Table(columns, cells)


def state_table(rows: Sequence[dict[str, Any]]) -> Table | None:
    """What the estimator claimed, what it had no need to do, and how often the fingertips disagreed."""
    states: Counter[str] = Counter()
    skipped: Counter[str] = Counter()
    apart: Counter[str] = Counter()
    for row in rows:
        states.update(row["states"])
        skipped.update(row.get("skipped") or {})
        apart.update(row.get("disagreements") or {})
    frames = sum(states.values())
    if not frames:
        return None
    cells = [
        [f"{kind} {name.replace('_', ' ')}", f"{count}", f"{count / frames:.1%}"]
        for kind, counts in (("state:", states), ("skipped:", skipped), ("fingertips apart:", apart))
        for name, count in counts.items()
    ]
    return Table(("of all tactile frames", "frames", "share"), cells)


def _middle(spent: list[dict[str, float]], key: str) -> float:
    return float(np.median([value[key] for value in spent]))
