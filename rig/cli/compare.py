"""`rig compare`: two sessions, or two estimators on one session, lift by lift."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rig.cli.common import JsonOption, emit_json, say, trial_jobs
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rig.report.compare import Comparison
    from rig.report.sides import Side


def compare(
    first: Annotated[
        str,
        typer.Argument(help="Session folder of a trial; with --on, an estimator, also package.module:Class."),
    ],
    second: Annotated[str, typer.Argument(help="The other one.")],
    on: Annotated[
        Path | None, typer.Option("--on", help="Session whose lifts both estimators are to see.")
    ] = None,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, max=64, help="Lifts side by side.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="The page; default compare_<A>_<B>.html here.",
            callback=file_place,
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare two trials, or two estimators on the lifts of one: paired differences with intervals.

    Lifts are paired by object and number. Sessions of one seed hold the same simulated lifts; on a
    real bench every lift is another one, and pairing takes only the object out.

    Examples:
      rig compare sessions/monday sessions/tuesday

      rig compare slip ellipse --on sessions/2026-11-21T093000_trial

      rig compare slip pca --on sessions/monday --out slip_pca.html --json

    """
    from drivers.errors import InputError
    from rig.report.compare import compare_lifts, verdict
    from rig.report.compare_page import compare_page
    from rig.report.sides import session_side
    from rig.report.write import write_page

    if out is None:
        file_place(Path("compare.html"))  # that the page can lie here is seen before hours of replays
    if first == second:
        raise InputError(f"{first} is given twice: name two sessions, or two estimators and --on SESSION")
    if on is not None:
        sides = _estimators(on, first, second, trial_jobs(jobs, True, False))
        about = f"Two estimators on the lifts of session {on.name}."
    else:
        sides = (session_side(Path(first)), session_side(Path(second)))
        about = f"Two sessions: {first} and {second}."
    notes = [note for side in sides for note in side.notes]
    for note in notes:
        say(f"note: {note}")
    names = _names(sides)
    same = sides[0].estimator == sides[1].estimator
    found = compare_lifts(names, sides[0].lifts, sides[1].lifts, same)
    page = out or Path(f"compare_{_file_part(names[0])}_{_file_part(names[1])}.html")
    write_page(page, compare_page(found, any(side.simulated for side in sides), about, notes))
    if json:
        said = verdict(found) if found.judged else None
        emit_json({"report": str(page), "verdict": said, **_figures(found)})
    else:
        _print(found)
        print(page)


def _estimators(on: Path, first: str, second: str, jobs: int) -> "tuple[Side, Side]":
    from rig.cli.printing import TrialProgress
    from rig.report.sides import estimator_side

    with TrialProgress(1) as progress:
        return estimator_side(on, first, jobs, progress), estimator_side(on, second, jobs, progress)


def _names(sides: "tuple[Side, Side]") -> tuple[str, str]:
    first, second = (side.name for side in sides)
    return (first, second) if first != second else (f"{first} (1)", f"{second} (2)")


def _file_part(name: str) -> str:
    return name.replace(":", ".").replace("/", "-")


def _print(found: "Comparison") -> None:
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table
    from rig.report.compare import verdict
    from rig.report.compare_page import figure_table, object_table
    from rig.results.metrics import FEWEST_LIFTS, INTERVAL

    console = table_console()
    title = f"{found.names[1]} less {found.names[0]}, with the {INTERVAL}, from {FEWEST_LIFTS} lifts on"
    for table in (figure_table(found), object_table(found)):
        console.print(console_table(table.columns, table.rows, title=title))
    console.print(verdict(found))
    for name, alone in zip(found.names, found.alone, strict=True):
        if alone:
            console.print(f"left out, only in {name}: {'; '.join(alone)}", highlight=False)


def _figures(found: "Comparison") -> dict[str, object]:
    from dataclasses import asdict

    def plain(value: Any) -> dict[str, object]:
        row = asdict(value)
        figure = row.pop("figure")
        return {**row, "figure": figure["name"], "unit": figure["unit"], "winner": value.winner}

    return {
        "names": list(found.names),
        "lifts": len(found.pairs),
        "left_out": dict(zip(found.names, found.alone, strict=True)),
        "figures": [plain(p) for p in found.overall],
        "objects": {name: plain(p) for name, p in found.objects.items()},
    }
