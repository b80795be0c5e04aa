"""`rig benchmark safety`: an event at a random moment of a lift, on a bench that counts as real."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import typer

from rig.benchmark.harness import Report, Run, Study, Table
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.wire.moments import Stage
from rig.benchmark.wire.safety_events import BY_NAME, EVENTS, After, plan_runs
from rig.benchmark.wire.safety_runs import SafetyRun, run_safety

STILL_S = 0.5
APPROACH_MM = 20.0
NOTICED_S = 1.0
"""From the loss of a device that the lift needs to standstill."""
COLUMNS = ("event", "runs", *(f"{stage}: s, mm" for stage in Stage), "dropped", "unasked", "lift lost")


@dataclass(frozen=True, slots=True)
class SafetyOptions:
    """Options of `rig benchmark safety`."""

    full: Annotated[
        bool, typer.Option("--full", help="Each event once in every stage: 102 runs, about 30 minutes.")
    ] = False


def measure(options: SafetyOptions, run: Run) -> Report:
    """Stop, kill or break a lift at random moments; print how the arm comes to rest.

    The trial is a program of its own on a simulated bench that counts as real. Its events are Ctrl-C once and
    twice, SIGTERM, SIGHUP, SIGQUIT, kill -9, SIGSTOP, protective and emergency stop, gripper, fingertip and
    camera lost, fingers that fail, disk full: each once in the plain run, about 25 s each. Exit code 4 if an
    object was dropped, if anything moved unasked, if a finished lift was lost, or if the arm did not stand
    within 0.5 s, and within 20 mm in the approach.

    Examples:
      rig benchmark safety

      rig benchmark safety --full --out safety --json

      rig benchmark safety --full --out safety --resume --readme docs/safety.md

    """
    runs = run_safety(run, plan_runs(run.seed, options.full))
    table, limits = safety_table(runs), judge_runs(runs)
    what = "longest time (s) and way (mm) from the event to standstill"
    head = f"SIMULATED, {len(runs)} runs, seed {run.seed}: {what}, by stage of the lift."
    section = "\n".join([head, "", table.markdown(), "", *(limit.line for limit in limits)])
    return Report((table,), limits, "the rig", section=section)


def judge_runs(runs: Sequence[SafetyRun]) -> tuple[Measured, ...]:
    """Return all limits; those on a stage or event of which there is no run are left out."""
    stopped = [run for run in runs if BY_NAME[run.event].after in (After.STAYS, After.SAFE_END)]
    lost = [run for run in runs if BY_NAME[run.event].after is After.NOTICED and BY_NAME[run.event].fault]
    way_mm = [run.way_mm for run in stopped if run.stage is Stage.APPROACH]
    lost_s = [run.still_s for run in lost if run.stage is Stage.LIFT]
    still_s = max((run.still_s for run in stopped), default=None)
    return (
        at_most("objects dropped", sum(run.dropped for run in runs), 0),
        at_most("runs in which something moved unasked", sum(bool(run.unasked) for run in runs), 0),
        at_most("finished lifts lost", sum(not run.kept for run in runs), 0),
        at_most("from the event to standstill, s", still_s, STILL_S),
        *(at_most("way to standstill in the approach, mm", max(way_mm), APPROACH_MM) for _ in way_mm[:1]),
        *(at_most("from a lost device to standstill, s", max(lost_s), NOTICED_S) for _ in lost_s[:1]),
        at_most("programs that ended without saying why", sum(not run.ended_well for run in runs), 0),
        at_most("benches that could not be put in order", sum(bool(run.ready) for run in runs), 0),
    )


def safety_table(runs: Sequence[SafetyRun]) -> Table:
    """Return a row for each event: how often, and by stage the longest time and way to standstill."""
    title = "SIMULATED bench 'wire': longest time and way from the event to standstill"
    cells = [_cells(event.name, [run for run in runs if run.event == event.name]) for event in EVENTS]
    return Table(title, COLUMNS, cells, records=tuple(runs))


def _cells(event: str, runs: Sequence[SafetyRun]) -> tuple[str, ...]:
    stages = [[run for run in runs if run.stage is stage] for stage in Stage]
    longest = [
        f"{max(r.still_s for r in s):.2f}, {max(r.way_mm for r in s):.1f}" if s else "-" for s in stages
    ]
    counts = [(run.dropped, bool(run.unasked), not run.kept) for run in runs]
    return (event, str(len(runs)), *longest, *(str(sum(each[i] for each in counts)) for i in range(3)))


STUDY = Study(
    name="safety",
    options=SafetyOptions,
    measure=measure,
    cases="runs",
    shared=("out", "resume", "readme", "seed"),
    keeps_results=True,
)
