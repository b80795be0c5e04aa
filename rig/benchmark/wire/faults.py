"""`rig benchmark faults`: devices fail during lifts over the wire protocols, and the rig has to recover."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer

from drivers.errors import InputError, counted
from rig.benchmark.harness import Report, Run, Study, Table, table_of
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.wire.campaign import count_faults, plan_campaign, run_campaign, worst
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.fault_lifts import MID_LIFT, FaultRow, run_faults
from rig.config import BenchConfig, load_bench


@dataclass(frozen=True, slots=True)
class FaultsOptions:
    """Options of `rig benchmark faults`."""

    cases: Annotated[
        list[str] | None,
        typer.Option("--case", help="Only cases whose name contains this; repeat for more."),
    ] = None
    full: Annotated[
        bool, typer.Option("--full", help="Every fault, also two at once, at random moments: hours.")
    ] = False
    count: Annotated[
        int,
        typer.Option("--count", min=1, max=100_000, help="How many faults with --full, two at once as two."),
    ] = 1000
    bench: Annotated[
        str,
        typer.Option("--bench", help="wire, or the path of a bench file whose \\[fakes] are started for it."),
    ] = "wire"
    jobs: Annotated[
        int,
        typer.Option("--jobs", min=1, max=64, help="Benches side by side with --full; about a core each."),
    ] = 1


def measure(options: FaultsOptions, run: Run) -> Report:
    """Let each device fail in mid-lift over the wire protocols; print how the rig recovers.

    Runs in real time, about 25 s a lift. The lifts are stored as a session in the folder of the results. With
    --full they are deleted, the worst case is filmed, into worst.avi, and --readme takes the table. Exit code
    4 if a fault was not seen, not named or not made safe within a second, if an object was dropped, or if the
    next lift did not run.

    Examples:
      rig benchmark faults

      rig benchmark faults --case arm --case "gripper: silent" --json

      rig benchmark faults --full --out campaign --resume --readme docs/wire.md

      rig benchmark faults --full --count 200 --jobs 8

      rig benchmark faults --full --bench slow.toml

    """
    bench = load_bench(options.bench)
    if bench.fakes is None or bench.fakes.control is not None:
        raise InputError(
            f"bench '{bench.name}': faults are injected into fakes that the benchmark starts itself; give a "
            "bench of real drivers with an empty [fakes] table, as wire"
        )
    return _campaign(bench, options, run) if options.full else _each_once(bench, options, run)


def _each_once(bench: BenchConfig, options: FaultsOptions, run: Run) -> Report:
    wanted = [c for c in CASES if not options.cases or any(text.lower() in c.name for text in options.cases)]
    if not wanted:
        names = ", ".join(case.name for case in CASES)
        raise InputError(f"no case contains {' or '.join(options.cases or [])}; cases are: {names}")
    if run.resume:
        raise InputError("--resume continues a campaign: give --full as well")

    def show(row: FaultRow) -> None:
        text = "; then: ".join(row.outcomes) or "no fault was noticed"
        run.progress(row.number, len(wanted), f"{row.fault}: {text}")

    rows = run_faults(run.results_folder, [(case, MID_LIFT) for case in wanted], show, bench)
    title = f"SIMULATED bench '{bench.name}': from the fault to the rig's stop, from there to standstill"
    return Report((table_of(title, FaultRow, rows, left=6),), judge_faults(rows), "the rig")


def _campaign(bench: BenchConfig, options: FaultsOptions, run: Run) -> Report:
    plan = plan_campaign(run.seed, options.count)
    planned = f"{counted(count_faults(plan), 'fault')} in {counted(len(plan), 'lift')}"
    head = f"SIMULATED, {planned} at random moments, seed {run.seed}"
    run.say(f"{head}; bench '{bench.name}'")
    rows = run_campaign(replace(run, jobs=options.jobs), plan, bench)
    table, limits, last = campaign_table(bench.name, rows), judge_faults(rows), worst(rows)
    return Report(
        tables=(table,),
        limits=limits,
        limits_of="the rig",
        notes=(f"longest until standstill: {last.line}",) if last else (),
        section="\n".join([f"{head}.", "", table.markdown(), "", *(limit.line for limit in limits)]),
    )


def judge_faults(rows: Sequence[FaultRow]) -> tuple[Measured, ...]:
    """Return the limits. Whether finished lifts are whole on disk was checked by `run_faults`."""
    return (
        at_most("objects dropped", sum(row.dropped for row in rows), 0),
        at_most("lifts after a fault that did not run", sum(not row.recovered for row in rows), 0),
        at_most("faults not seen, not named or not made safe", sum(not row.passed for row in rows), 0),
    )


CAMPAIGN_COLUMNS = (
    "fault", "lifts", "with another", "seen, s: median", "longest", "stood, s: longest", "not missed",
    "dropped", "next lift", "passed",
)  # fmt: skip


def campaign_table(bench: str, rows: Sequence[FaultRow]) -> Table:
    """Return a row for each fault; two at once count under the first one's name."""
    title = f"SIMULATED bench '{bench}': faults at random moments of every stage"
    firsts = {case.name: [row for row in rows if row.fault.split(" + ")[0] == case.name] for case in CASES}
    cells = [_cells(name, of) for name, of in firsts.items()]
    return Table(title, CAMPAIGN_COLUMNS, cells, records=tuple(rows))


def _cells(name: str, rows: Sequence[FaultRow]) -> tuple[str, ...]:
    seen = [row.seen_s for row in rows if row.seen_s is not None]
    return (
        name,
        str(len(rows)),
        str(sum(" + " in row.fault for row in rows)),
        f"{np.median(seen):.2f}" if seen else "-",
        f"{max(seen):.2f}" if seen else "-",
        f"{max((row.still_s for row in rows), default=0.0):.2f}",
        str(sum(not row.outcomes for row in rows)),
        str(sum(row.dropped for row in rows)),
        f"{sum(row.recovered for row in rows)} of {len(rows)}",
        f"{sum(row.passed for row in rows)} of {len(rows)}",
    )


def _section(options: FaultsOptions) -> str:
    if not options.full:
        raise InputError("--readme takes the table of a campaign: give --full as well")
    return "faults"


STUDY = Study(
    name="faults",
    options=FaultsOptions,
    measure=measure,
    cases="faults",
    shared=("out", "resume", "readme", "seed"),
    section=_section,
    keeps_results=True,
)
