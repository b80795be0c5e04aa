"""`rig benchmark faults`: devices fail during lifts over the wire protocols, and the rig has to recover.

With `--full` every fault comes alone and with another, at random moments of every stage. Lifts are done in
parts of ten, each a trial on a bench of its own. The rows of a part are stored and its recordings are
deleted, except that of the worst fault so far. A part that was interrupted is run again.
"""

import random
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.errors import InputError, counted
from rig.benchmark.harness import Report, Run, Study, Table, option, table_of
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.wire.fault_cases import CASES, FaultCase, both
from rig.benchmark.wire.fault_lifts import MID_LIFT, FaultRow, Planned, run_faults
from rig.benchmark.wire.world import Stage, random_moment, tried
from rig.config import BenchConfig, load_bench
from rig.sessions.files import recording_file

PART = 10
TWO_AT_ONCE = 1 / 3
"""Share of the lifts in which two faults come at once."""
PART_FOLDER, WORST = "part", "worst.mcap"


def plan_campaign(seed: int, count: int) -> list[Planned]:
    """Draw the lifts of `count` faults: each in each stage equally often, a third with another device's."""
    rng = random.Random(seed)  # noqa: S311 - moments, no secrets
    plan: list[Planned] = []
    while count_faults(plan) < count:
        cells = [(case, stage) for case in CASES for stage in Stage]
        rng.shuffle(cells)
        plan += [(_maybe_two(case, rng), random_moment(stage, rng)) for case, stage in cells]
    while count_faults(plan[:-1]) >= count:
        plan.pop()
    return plan


def count_faults(plan: Sequence[Planned]) -> int:
    """Return how many faults a plan has; two at once are two."""
    return sum(case.faults for case, _ in plan)


def _maybe_two(case: FaultCase, rng: random.Random) -> FaultCase:
    others = [other for other in CASES if other.name.partition(":")[0] != case.name.partition(":")[0]]
    return both(case, rng.choice(others)) if rng.random() < TWO_AT_ONCE else case


@dataclass(frozen=True, slots=True)
class _Part:
    """Lifts that are next to each other in the plan. first: the number of the first one, from 1."""

    first: int
    planned: Sequence[Planned]

    def __str__(self) -> str:
        return f"lifts {self.first} to {self.first + len(self.planned) - 1}"

    @property
    def folder(self) -> str:
        """Folder of its lifts, within that of the campaign."""
        return f"{PART_FOLDER}_{self.first}"


@dataclass(frozen=True, slots=True)
class PartRows:
    """The faults of a part."""

    rows: tuple[FaultRow, ...]


def run_campaign(run: Run, plan: Sequence[Planned], bench: BenchConfig) -> list[FaultRow]:
    """Run the parts that are not in the run's folder yet; return the rows of all, in the plan's order.

    run.jobs: benches side by side, each in real time. Raises `InputError` for a folder with faults of another
    plan, bench or seed, and what `Run.each` and `run_faults` raise.
    """
    folder, common = run.results_folder, f"bench '{bench.name}', seed {run.seed}, "
    parts = [_Part(i + 1, plan[i : i + PART]) for i in range(0, len(plan), PART)]
    stored = run.stored(PartRows, common)
    for part in parts:
        rows = stored[common + str(part)].rows if common + str(part) in stored else ()
        if rows and [row.fault for row in rows] != [case.name for case, _ in part.planned]:
            raise InputError(f"{folder}: its {part} have the faults of another version; give another folder")
    known = [row for of in stored.values() for row in of.rows]

    def finish(part: _Part, new: PartRows) -> str:
        last = worst([*known, *new.rows])
        if last in new.rows:
            recording = recording_file(1 + last.number - part.first, 0)
            shutil.copy(folder / part.folder / recording, folder / WORST)
        shutil.rmtree(folder / part.folder)
        known.extend(new.rows)
        return "\n  ".join([f"{part}:", *(row.line for row in new.rows)])

    work = partial(_run_part, folder, bench)
    done = run.each(work, parts, lambda part: common + str(part), PartRows, common=common, finish=finish)
    return [row for of in done for row in of.rows]


def _run_part(folder: Path, bench: BenchConfig, part: _Part) -> PartRows:
    """Run a part, and again if no lift runs any more although every device is mended."""

    def run_once() -> list[FaultRow]:
        shutil.rmtree(folder / part.folder, ignore_errors=True)
        return run_faults(folder / part.folder, part.planned, bench=bench)

    return PartRows(tuple(replace(row, number=part.first + row.number - 1) for row in tried(run_once)))


def worst(rows: Sequence[FaultRow]) -> FaultRow | None:
    """Return the fault with the longest time until the tool stood; a failed one comes before all others."""
    seen = [row for row in rows if row.outcomes]
    return max(seen, key=lambda row: (not row.passed, row.still_s), default=None)


@dataclass(frozen=True, slots=True)
class FaultsOptions:
    """Options of `rig benchmark faults`."""

    cases: list[str] | None = option(None, "Only cases whose name contains this; repeat for more.", "--case")
    full: bool = option(False, "Every fault, also two at once, at random moments: hours.")
    count: int = option(1000, "How many faults with --full, two at once as two.", min=1, max=100_000)
    bench: str = option("wire", "wire, or the path of a bench file whose \\[fakes] are started for it.")
    jobs: int = option(1, "Benches side by side with --full; about a core each.", min=1, max=64)


def measure(options: FaultsOptions, run: Run) -> Report:
    """Let each device fail during a lift over the wire protocols; print how the rig recovers.

    The lifts run in real time, about 25 s per lift, and are stored as a session in the folder of the results.
    With --full they are deleted except that of the worst case, worst.mcap, and --readme receives the table.
    The exit code is 4 if a fault was not detected, not named or not made safe within a second, if an object
    was dropped, or if the next lift did not run.

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
