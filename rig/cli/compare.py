"""`rig compare`: compare two sessions, or two estimators on one session, lift by lift."""

import os
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from rig.cli.common import print_result, report_faults, say, trial_jobs
from rig.cli.options import JsonOption
from rig.declared import argument, file_place, option
from rig.terminal.progress import WorkProgress
from rig.terminal.screen import begin_phase, end_phase


@dataclass(frozen=True, slots=True)
class CompareOptions:
    first: str = argument(
        ..., "Session folder of a trial; with --on, an estimator (a name or package.module:Class)."
    )
    second: str = argument(..., "Session or estimator to compare the first with.")
    on: Path | None = option(None, "Session on whose lifts both estimators run.")
    jobs: int | None = option(None, "Lifts in parallel. Default: one per core.", min=1, max=64)
    out: Path | None = option(
        None, "HTML file to write. Default: compare_<A>_<B>.html in this folder.", callback=file_place
    )
    json: JsonOption = False


def compare(options: CompareOptions) -> None:
    """Compare two trials, or two estimators on one trial, by paired differences with intervals.

    Lifts are paired by object and number. Simulated sessions of the same seed hold the same lifts. On a real
    bench no two lifts are the same: there the pairing only removes the differences between objects.

    Examples:
      rig compare sessions/monday sessions/tuesday
      rig compare slip ellipse --on sessions/2026-11-21T093000_trial
      rig compare slip pca --on sessions/monday --out slip_pca.html --json
    """
    from rig.report.compare import compare_lifts, compare_page, figure_table, object_table, verdict
    from rig.report.sides import estimator_sides, session_side
    from rig.report.write import write_page
    from rig.results.metrics import FEWEST_LIFTS, INTERVAL
    from rig.terminal.tables import console_table, table_console

    if options.out is None:
        file_place(Path("compare.html"))  # an unwritable folder is reported before hours of replays
    first, second, on = options.first, options.second, options.on
    if first == second:
        raise InputError(f"{first} is given twice: name two sessions, or two estimators and --on SESSION")
    if on is None:
        sides = session_side(Path(first)), session_side(Path(second))
        about = f"Two sessions: {first} and {second}."
    else:
        jobs = trial_jobs(options.jobs, True, False)
        with WorkProgress(1, "lifts") as bar:
            sides = estimator_sides(on, first, second, jobs, bar.show)
        about = f"Two estimators on the lifts of session {on.name}."
    notes = [note for side in sides for note in side.notes]
    for note in notes:
        say(f"note: {note}")
    names = sides[0].name, sides[1].name
    if names[0] == names[1]:
        names = f"{names[0]} (1)", f"{names[1]} (2)"
    same = sides[0].estimator == sides[1].estimator
    found = compare_lifts(names, sides[0].lifts, sides[1].lifts, same)
    parts = (name.replace(":", ".").replace("/", "-") for name in names)
    page = options.out or Path(f"compare_{'_'.join(parts)}.html")
    end_phase(wait=True)  # workers are forks, which must not copy a thread
    begin_phase("writing the page", ticking=False)
    simulated = any(side.simulated for side in sides)
    write_page(page, compare_page(found, simulated, about, notes, os.cpu_count() or 1))
    if not options.json:
        console = table_console()
        least = f"{INTERVAL} if there are at least {FEWEST_LIFTS} lifts"
        for table in (figure_table(found), object_table(found)):
            if table.rows:
                title = f"{names[1]} minus {names[0]}; {least}"
                console.print(console_table(table.columns, table.rows, title=title))
        for own in found.apart:
            console.print(own.text, highlight=False)
        console.print(verdict(found))
        for name, alone in zip(names, found.alone, strict=True):
            if alone:
                console.print(f"left out because only {name} has them: {'; '.join(alone)}", highlight=False)
    said = verdict(found) if found.judged else None
    print_result(options.json, {"report": str(page), "verdict": said, **found.as_json()}, page)
    if on is not None:
        rows = [lift for side in sides for lift in side.lifts]
        report_faults(row.estimator_faults for row in rows if row.estimator_faults)
