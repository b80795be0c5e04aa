"""`rig benchmark safety`: something happens to a lift at any moment; what moved is held against the world."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.benchmark.studies import exit_if_missed
from rig.cli.common import JsonOption, ResumeOption, SeedOption, emit_json, say, session_folder
from rig.cli.places import file_place, folder_place

if TYPE_CHECKING:
    from rig.benchmark.wire.safety import SafetyRun


def safety(
    full: Annotated[
        bool, typer.Option("--full", help="Each event once in every stage: 102 runs, about 30 minutes.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the runs.", callback=folder_place)
    ] = None,
    resume: ResumeOption = False,
    readme: Annotated[
        Path | None,
        typer.Option(
            "--readme", help="Write the table into this file, between its two markers.", callback=file_place
        ),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Stop, kill or break a lift at random moments on the bench behind wires; print how it comes to rest.

    The trial is a program of its own at a bench that counts as real. Ctrl-C once and twice, SIGTERM,
    SIGHUP, SIGQUIT, kill -9, SIGSTOP, protective and emergency stop, gripper, fingertip and camera lost, disk
    full: each once in the plain run, about 25 s each. Exit code 4 when an object was dropped, anything
    moved unasked, a finished lift was lost, or the arm did not stand within 0.5 s, and within 20 mm
    in the approach.

    Examples:
      rig benchmark safety

      rig benchmark safety --full --out safety --json

      rig benchmark safety --full --out safety --resume --readme docs/safety.md

    """
    from rig.benchmark.readme import check_readme, write_section
    from rig.benchmark.wire.safety import run_safety
    from rig.benchmark.wire.safety_events import plan_runs
    from rig.benchmark.wire.safety_limits import judge_runs
    from rig.benchmark.wire.safety_page import section

    if readme is not None:
        check_readme(readme, "safety")
    folder = session_folder(out, resume, "safety")
    plan = plan_runs(seed, full)
    say(f"SIMULATED bench 'wire', {len(plan)} runs, seed {seed}, folder {folder}")
    runs = run_safety(folder, plan, resume, lambda run: say(f"  {run.number}/{len(plan)} {_line(run)}"))
    limits = judge_runs(runs)
    if json:
        from dataclasses import asdict

        figures = {"runs": [asdict(run) for run in runs], "limits": [asdict(limit) for limit in limits]}
        emit_json({"folder": str(folder), "simulated": True, **figures})
    else:
        _print_table(runs)
    if readme is not None:
        write_section(readme, "safety", section(runs, seed))
    exit_if_missed(limits)


def _line(run: "SafetyRun") -> str:
    wrong = [
        *(["DROPPED"] if run.dropped else []),
        *([f"UNASKED: {run.unasked}"] if run.unasked else []),
        *([] if run.kept else ["FINISHED LIFT LOST"]),
        *([] if run.ended_well else [f"ended with {run.ended}: {run.said}"]),
        *([f"not in order: {run.ready}"] if run.ready else []),
    ]
    stood = f"stood after {run.still_s:.2f} s, {run.way_mm:.1f} mm"
    return "; ".join([f"{run.event}, {run.stage}: {stood}", *wrong])


def _print_table(runs: "list[SafetyRun]") -> None:
    from rich.table import Table

    from rig.benchmark.wire.safety_limits import COLUMNS, table_rows
    from rig.cli.fitting import table_console

    table = Table(*COLUMNS, title="SIMULATED bench 'wire': longest time and way from the event to standstill")
    for row in table_rows(runs):
        table.add_row(*row)
    table_console().print(table)
