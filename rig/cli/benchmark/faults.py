"""`rig benchmark faults`: devices fail on the bench behind wires, and the rig has to come through."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.benchmark.studies import exit_if_missed
from rig.cli.benchmark.tables import ReadmeOption
from rig.cli.common import Exit, JsonOption, ResumeOption, SeedOption, emit_json, say, session_folder
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.benchmark.wire.campaign import FaultRow
    from rig.benchmark.wire.faults import FaultResult
    from rig.config import BenchConfig


def faults(
    cases: Annotated[
        list[str] | None,
        typer.Option("--case", help="Only cases whose name contains this; repeat for more."),
    ] = None,
    full: Annotated[
        bool,
        typer.Option("--full", help="Every fault, also two at once, at random moments: hours."),
    ] = False,
    count: Annotated[
        int,
        typer.Option("--count", min=1, max=100_000, help="How many faults with --full, two at once as two."),
    ] = 1000,
    bench: Annotated[
        str,
        typer.Option("--bench", help="wire, or the path of a bench file whose \\[fakes] are started for it."),
    ] = "wire",
    out: Annotated[
        Path | None, typer.Option("--out", help="Session folder of the lifts.", callback=folder_place)
    ] = None,
    resume: ResumeOption = False,
    jobs: Annotated[
        int,
        typer.Option("--jobs", min=1, max=64, help="Benches side by side with --full; about a core each."),
    ] = 1,
    readme: ReadmeOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Let each device fail in mid-lift on the bench behind wires; print how the rig comes through.

    Runs in real time, about 25 s a lift. Exit code 4 when a fault was not seen, not named, not
    made safe within a second, something was dropped, or the next lift did not run. With --full the
    worst case is filmed, into worst.avi, and --readme takes the table.

    Examples:
      rig benchmark faults

      rig benchmark faults --case arm --case "gripper: silent" --json

      rig benchmark faults --full --out campaign --resume --readme docs/wire.md

      rig benchmark faults --full --count 200 --jobs 8

      rig benchmark faults --full --bench slow.toml

    """
    from drivers.errors import InputError
    from rig.benchmark.readme import check_readme

    config = _wire_bench(bench)
    if readme is not None:
        if not full:
            raise InputError("--readme takes the table of a campaign: give --full as well")
        check_readme(readme, "faults")
    if full:
        _campaign(config, session_folder(out, resume, "faults"), seed, count, resume, jobs, readme, json)
    else:
        _each_once(config, cases, session_folder(out, False, "faults"), json)


def _wire_bench(name: str) -> "BenchConfig":
    """Return a bench whose fakes the benchmark starts, and nothing else uses. Raises `InputError`."""
    from drivers.errors import InputError
    from rig.config import load_bench

    config = load_bench(name)
    if config.fakes is None or config.fakes.control is not None:
        raise InputError(
            f"bench '{config.name}': faults are injected into fakes that the benchmark starts itself; give a "
            "bench of real drivers with an empty [fakes] table, as wire"
        )
    return config


def _campaign(
    config: "BenchConfig",
    folder: Path,
    seed: int,
    count: int,
    resume: bool,
    jobs: int,
    readme: Path | None,
    json: bool,
) -> None:
    from rig.benchmark.readme import write_section
    from rig.benchmark.wire.campaign import (
        campaign_section,
        count_faults,
        judge_campaign,
        plan_campaign,
        run_campaign,
        worst,
    )

    plan = plan_campaign(seed, count)
    planned = f"{counted(count_faults(plan), 'fault')} in {counted(len(plan), 'lift')}"
    title = f"SIMULATED, {planned} at random moments, seed {seed}"
    say(f"{title}; bench '{config.name}', folder {folder}")
    rows = run_campaign(folder, plan, resume, lambda row: say(f"  {_line(row)}"), config, jobs)
    limits = judge_campaign(rows)
    if json:
        from dataclasses import asdict

        figures = {"faults": [asdict(row) for row in rows], "limits": [asdict(limit) for limit in limits]}
        emit_json({"folder": str(folder), "simulated": True, **figures})
    else:
        _print_campaign(config.name, rows)
        if found := worst(rows):
            say(f"longest until standstill: {_line(found)}")
    if readme is not None:
        write_section(readme, "faults", campaign_section(title, rows))
    exit_if_missed(limits)


def _line(row: "FaultRow") -> str:
    seen = "over before it was missed" if row.seen_s is None else f"seen after {row.seen_s:.2f} s"
    verdict = "passed" if row.passed else f"FAILED: {'; '.join(row.outcomes) or 'no fault was noticed'}"
    return f"{row.number} {row.fault}, {row.stage}: {seen}, stood after {row.still_s:.2f} s; {verdict}"


def _print_campaign(bench: str, rows: "list[FaultRow]") -> None:
    from rich.table import Table

    from rig.benchmark.wire.campaign import CAMPAIGN_COLUMNS, campaign_rows
    from rig.cli.fitting import table_console

    title = f"SIMULATED bench '{bench}': faults at random moments of every stage"
    table = Table(*CAMPAIGN_COLUMNS, title=title)
    for row in campaign_rows(rows):
        table.add_row(*row)
    table_console().print(table)


def _each_once(config: "BenchConfig", cases: list[str] | None, folder: Path, json: bool) -> None:
    from drivers.errors import InputError
    from rig.benchmark.wire.fault_cases import CASES
    from rig.benchmark.wire.faults import MID_LIFT, run_faults

    wanted = tuple(c for c in CASES if not cases or any(text.lower() in c.name for text in cases))
    if not wanted:
        names = ", ".join(case.name for case in CASES)
        raise InputError(f"no case contains {' or '.join(cases or [])}; cases are: {names}")
    say(f"SIMULATED bench '{config.name}', {counted(len(wanted), 'fault')} in mid-lift, session {folder}")
    planned = [(case, MID_LIFT) for case in wanted]
    results = run_faults(
        folder, planned, lambda result: say(f"  {result.case.name}: {_outcome(result)}"), config
    )
    if json:
        emit_json({"session": str(folder), "faults": [_plain(result) for result in results]})
    else:
        _print_table(config.name, results)
    if not all(result.passed for result in results):
        raise typer.Exit(Exit.LIMIT_MISSED)


def _outcome(result: "FaultResult") -> str:
    return "; then: ".join(result.faults) if result.faults else "no fault was noticed"


def _short(result: "FaultResult") -> str:
    """What failed, without the advice, and how the bench was left."""
    parts = []
    for fault in result.faults:
        text, _, left = fault.partition(" [")
        parts.append(f"{text.partition('; ')[0]} ({left.partition(' (')[0].rstrip(']') or 'nothing moved'})")
    return "; then: ".join(parts) or "no fault was noticed"


def _plain(result: "FaultResult") -> dict[str, object]:
    return {
        "fault": result.case.name,
        "detected_s": result.detected_s,
        "still_s": result.safe_s,
        "outcomes": result.faults,
        "recovered": result.recovered,
        "passed": result.passed,
    }


def _print_table(bench: str, results: "list[FaultResult]") -> None:
    from rich.table import Table

    from rig.cli.fitting import table_console

    table = Table("fault in mid-lift", "detected, s", "then still, s", "outcome", "next lift", "")
    table.title = f"SIMULATED bench '{bench}': from the fault to the rig's stop, from there to standstill"
    for result in results:
        times = ["never" if t is None else f"{t:.3f}" for t in (result.detected_s, result.safe_s)]
        after = "done" if result.recovered else "not done"
        verdict = "passed" if result.passed else "FAILED"
        table.add_row(result.case.name, *times, _short(result), after, verdict)
    table_console().print(table)
