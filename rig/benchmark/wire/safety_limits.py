"""The limits of `rig benchmark safety`, and its table."""

from collections.abc import Iterable, Sequence

from rig.benchmark.measured import Measured, at_most
from rig.benchmark.wire.moments import Stage
from rig.benchmark.wire.safety import SafetyRun
from rig.benchmark.wire.safety_events import BY_NAME, EVENTS, After, Event

STILL_S = 0.5
APPROACH_MM = 20.0
NOTICED_S = 1.0
"""From the loss of a device that the lift needs to standstill."""


def judge_runs(runs: Sequence[SafetyRun]) -> list[Measured]:
    """Return all limits in the order of the table."""
    stopped = [run for run in runs if BY_NAME[run.event].after in (After.STAYS, After.SAFE_END)]
    lost = [run for run in runs if BY_NAME[run.event].after is After.NOTICED and BY_NAME[run.event].fault]
    return [
        at_most("objects dropped", sum(run.dropped for run in runs), 0),
        at_most("runs in which something moved unasked", sum(bool(run.unasked) for run in runs), 0),
        at_most("finished lifts lost", sum(not run.kept for run in runs), 0),
        at_most("from the event to standstill, s", _most(run.still_s for run in stopped), STILL_S),
        *_if_any(
            "way to standstill in the approach, mm", _in(stopped, Stage.APPROACH, "way_mm"), APPROACH_MM
        ),
        *_if_any("from a lost device to standstill, s", _in(lost, Stage.LIFT, "still_s"), NOTICED_S),
        at_most("programs that ended without saying why", sum(not run.ended_well for run in runs), 0),
        at_most("benches that could not be put in order", sum(bool(run.ready) for run in runs), 0),
    ]


def table_rows(runs: Sequence[SafetyRun]) -> list[list[str]]:
    """Return a row for each event: how often, and by stage the longest time and way to standstill."""
    return [_row(event, [run for run in runs if run.event == event.name]) for event in EVENTS]


COLUMNS = ("event", "runs", *(f"{stage}: s, mm" for stage in Stage), "dropped", "unasked", "lift lost")


def _row(event: Event, runs: Sequence[SafetyRun]) -> list[str]:
    counts = [sum(run.dropped for run in runs), sum(bool(run.unasked) for run in runs)]
    counts.append(sum(not run.kept for run in runs))
    return [event.name, str(len(runs)), *(_cell(runs, stage) for stage in Stage), *map(str, counts)]


def _cell(runs: Sequence[SafetyRun], stage: Stage) -> str:
    here = [run for run in runs if run.stage is stage]
    if not here:
        return "-"
    return f"{max(run.still_s for run in here):.2f}, {max(run.way_mm for run in here):.1f}"


def _in(runs: Iterable[SafetyRun], stage: Stage, figure: str) -> list[float]:
    return [getattr(run, figure) for run in runs if run.stage is stage]


def _if_any(name: str, values: list[float], limit: float) -> list[Measured]:
    """A limit on what a plain run may have no run of."""
    return [at_most(name, max(values), limit)] if values else []


def _most(values: Iterable[float]) -> float | None:
    return max(values, default=None)
