"""Tables of counts and times of a trial."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from rig.report.parts import Table
from rig.results.metrics import FEWEST_LIFTS, Floats
from rig.sessions.records import Lift
from rig.sessions.timing import LiftTiming, StageTimes


def stage_table(timing: Sequence[LiftTiming]) -> Table | None:
    """Return a table of the wall time per stage and frame: percentiles of the median and the worst lift."""
    stages: dict[str, list[StageTimes]] = {}
    for row in timing:
        for name, spent in row.stages.items():
            stages.setdefault(name, []).append(spent)
    if not stages:
        return None
    middle = {name: _middle(spent) for name, spent in stages.items()}
    ordered = sorted(stages, key=lambda name: (name == "total", -middle[name].p50_ms))
    rows = [
        [
            name,
            f"{middle[name].p50_ms:.2f}",
            f"{middle[name].p95_ms:.2f}",
            f"{middle[name].p99_ms:.2f}",
            f"{max(spent.p99_ms for spent in stages[name]):.2f}",
        ]
        for name in ordered
    ]
    columns = ("stage", "median, ms", "95 %, ms", "99 %, ms", "99 % in the worst lift, ms")
    return Table(columns, rows, total=True)


def counts_table(rows: Sequence[Lift]) -> Table | None:
    """Return a table of received and dropped frames per source."""
    frames: Counter[str] = Counter()
    dropped: Counter[str] = Counter()
    for row in rows:
        frames.update(row.frames)
        dropped.update(row.dropped)
    if not frames:
        return None
    cells = [[source, f"{frames[source]}", f"{dropped[source]}"] for source in frames]
    return Table(("source", "frames", "dropped"), cells)


def onset_delays_ms(rows: Sequence[Lift]) -> dict[str, Floats]:
    """Return the delays of the estimated onset and of the slip event after the true onset, (N,) ms.

    The slip event is compared with `slip_start_s`, which also exists if a reaction stops the rotation early.
    """
    seen = {
        "estimated curve": [(row.onset_estimate_s, row.onset_truth_s) for row in rows],
        "slip event": [(row.onset_alarm_s, row.slip_start_s) for row in rows],
    }
    return {
        name: np.array([(s - t) * 1e3 for s, t in onsets if s is not None and t is not None], float)
        for name, onsets in seen.items()
    }


def onset_table(rows: Sequence[Lift]) -> Table | None:
    """Return a table of medians and 90 % ranges of `onset_delays_ms`; None if no lift has a true slip.

    Below `FEWEST_LIFTS` delays there is no range.
    """
    slips = [
        sum(row.onset_truth_s is not None for row in rows),
        sum(row.slip_start_s is not None for row in rows),
    ]
    if not any(slips):
        return None
    still = [row for row in rows if row.slip_start_s is None and not row.reactions]
    unasked = (
        sum(row.onset_estimate_s is not None for row in still),
        sum(row.onset_alarm_s is not None for row in still),
    )
    cells = []
    for (name, late_ms), true, false in zip(onset_delays_ms(rows).items(), slips, unasked, strict=True):
        middle = f"{np.median(late_ms):+.0f}" if late_ms.size else "-"
        ends = (
            [f"{v:+.0f}" for v in np.percentile(late_ms, [5, 95])]
            if late_ms.size >= FEWEST_LIFTS
            else ["-"] * 2
        )
        cells.append([name, f"{late_ms.size} of {true}", middle, *ends, str(false)])
    columns = ("onset by", "slips seen", "median, ms", "5 %, ms", "95 %, ms", "in lifts without a slip")
    return Table(columns, cells)


def state_table(rows: Sequence[Lift]) -> Table | None:
    """Return a table of the estimator's states, its skipped stages, and disagreements of the fingertips."""
    states: Counter[str] = Counter()
    skipped: Counter[str] = Counter()
    apart: Counter[str] = Counter()
    for row in rows:
        states.update(row.states)
        skipped.update(row.skipped)
        apart.update(row.disagreements)
    frames = sum(states.values())
    if not frames:
        return None
    cells = [
        [f"{kind} {name.replace('_', ' ')}", f"{count}", f"{count / frames:.1%}"]
        for kind, counts in (("state:", states), ("skipped:", skipped), ("fingertips apart:", apart))
        for name, count in counts.items()
    ]
    return Table(("of all tactile frames", "frames", "share"), cells)


def _middle(spent: list[StageTimes]) -> StageTimes:
    return StageTimes(*np.median([(s.p50_ms, s.p95_ms, s.p99_ms) for s in spent], axis=0).tolist())
