"""`rig benchmark estimators`: every estimator on the same frames, run time against error."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import typer

from rig.cli.benchmark.studies import exit_if_missed
from rig.cli.benchmark.tables import ReadmeOption, say_faults
from rig.cli.common import JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from rig.benchmark.estimators.benchmark import BenchmarkResult
    from rig.benchmark.harness import Table


def estimators(
    full: Annotated[
        bool, typer.Option("--full", help="More lifts, seeds and steps: about an hour on two cores.")
    ] = False,
    session: Annotated[
        Path | None,
        typer.Option("--session", help="Use the lifts of this trial instead of recording 45 simulated ones."),
    ] = None,
    more: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            help="One more beside those that are always compared, as package.module:Class; repeat for more.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for results.json, pareto.png, index.html and table.md; recorded lifts too.",
            callback=folder_place,
        ),
    ] = None,
    readme: ReadmeOption = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, max=64, help="Worker processes; default: cores.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Time and score every estimator by window on 45 lifts, then put them under stress.

    About 8 minutes on two quiet cores; run time is measured in one process and one thread. Exit code
    4 when a limit of the default estimator was missed.

    Examples:
      rig benchmark

      rig benchmark estimators --session sessions/2026-11-21T093000_trial --out benchmark

      rig benchmark estimators --full --readme docs/estimators.md

      rig benchmark estimators --estimator my_lab.rotation:MyEstimator --out benchmark

    """
    from rig.benchmark.estimators.benchmark import BenchmarkSettings, as_json, run_benchmark
    from rig.benchmark.estimators.files import check_writable, write_results
    from rig.sessions.session import default_folder

    folder = out or default_folder("benchmark")
    check_writable(folder, readme)
    settings = BenchmarkSettings(
        folder, session, seed, full, jobs or max(1, os.cpu_count() or 1), more=tuple(more or ())
    )
    say(f"benchmark of estimators, seed {seed}, results in {folder}")
    with Parts() as parts:
        result = run_benchmark(settings, parts)
    write_results(folder, result, readme)
    _print(result, json)
    say_faults(result.faults)
    if json:
        emit_json({"out": str(folder), **as_json(result)})
    exit_if_missed(result.limits)


class Parts:
    """A progress bar per part of the run, one after the other."""

    def __init__(self) -> None:
        from rig.cli.printing import WorkProgress

        self._make = WorkProgress
        self._part: str | None = None
        self._bar: WorkProgress | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.__exit__(*_)

    def __call__(self, part: str, done: int, total: int, note: str) -> None:
        """Show how far a part is."""
        if part != self._part or self._bar is None:
            self.__exit__()
            self._part, self._bar = part, self._make(total, part)
            self._bar.__enter__()
        self._bar.show(done, total, f"{part}: {note}" if part not in note else note)


def _print(result: "BenchmarkResult", to_stderr: bool) -> None:
    from rig.benchmark.estimators.tables import estimator_table, notes, stress_table, time_table
    from rig.benchmark.harness import limit_table
    from rig.cli.fitting import table_console
    from rig.tactile.estimators import DEFAULT_ESTIMATOR

    console = table_console(to_stderr)
    tables = (
        time_table(result),
        stress_table(result),
        estimator_table(result),
        limit_table(result.limits, f"'{DEFAULT_ESTIMATOR}'"),
    )
    for table in tables:
        console.print(_rich(table))
    for note in notes(result):
        console.print(note, highlight=False)
    console.print(f"{result.wall_s:.0f} s", highlight=False)


def _rich(table: "Table") -> "RichTable":
    from rich.table import Table as RichTable

    text = ("estimator", "stage", "group", "condition", "limit", "asked", "worst lift", "")
    shown = RichTable(title=table.title)
    for column in table.columns:
        shown.add_column(column, justify="left" if column in text else "right", no_wrap=column in text[:5])
    for row in table.rows:
        shown.add_row(*row)
    return shown
