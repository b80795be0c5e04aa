"""`rig results`: summarize a results table of many lifts. Also prints the tables of other commands."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drivers.errors import counted
from rig.cli.common import emit_json, mark
from rig.cli.options import JsonOption

if TYPE_CHECKING:
    from rich.table import Table

    from rig.results.limits import Judged
    from rig.results.summary import TrialSummary
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.table_files import Line


By = Literal["object", "session"]
"""Whether a row of a summary is an object or a session."""


def results(
    table: Annotated[
        Path, typer.Argument(help="results.csv, results.parquet, or the folder that `rig replay` wrote.")
    ],
    by: Annotated[By, typer.Option("--by", help="Print a row per object or per session.")] = "object",
    json: JsonOption = False,
) -> None:
    """Summarize a results table: MARE with intervals, agreement with stored lifts, broken sessions.

    Examples:
      rig results sessions/ellipse
      rig results sessions/ellipse/results.csv --by session --json
    """
    from rig.results.table import read_results, results_json

    rows = read_results(table)
    print_results(rows, by, to_stderr=json)
    if json:
        emit_json({"table": str(table), **results_json(rows)})


def print_results(
    rows: "list[Line]", by: By, to_stderr: bool, stored: "Sequence[TrialManifest]" = ()
) -> None:
    """Print the summary of a table's rows by object or by session, then the broken sessions.

    stored: see `agreement_text`.
    """
    from rig.results.metrics import HEADING, mare_text
    from rig.results.notes import agreement_text
    from rig.results.table import agreement, by_reaction, measured, summarize_table
    from rig.terminal.tables import console_table, table_console

    console = table_console(to_stderr)
    good = [row for row in rows if measured(row)]
    if by == "object" and good:
        for react, own in by_reaction(good).items():
            simulated = mark(any(row["simulated"] for row in own))
            console.print(object_table(summarize_table(own), simulated, react))
    elif good:
        columns = ("session", "estimator", "reaction", "lifts", "phase B", "phases B and C", "answered")
        lines = []
        for session in dict.fromkeys(str(row["session"]) for row in good):
            own = [row for row in good if row["session"] == session]
            summary, estimators = summarize_table(own), {str(row["estimator"]) for row in own}
            figures = mare_text(summary.mare_b), mare_text(summary.mare), f"{summary.answered:.1%}"
            about = Path(session).name, ", ".join(estimators), ", ".join(by_reaction(own))
            lines.append((*about, str(len(own)), *figures))
        title = f"{mark(any(row['simulated'] for row in good))}MARE per session, degrees: {HEADING}"
        console.print(console_table(columns, lines, range(3), title))
    estimators = ", ".join(sorted({str(row["estimator"]) for row in good})) or "none"
    found = agreement(good)
    same = f"; {agreement_text(found, stored)}" if found else ""
    console.print(f"estimator {estimators}{same}", highlight=False)
    lines = [f"broken: {row['problem']}" for row in rows if row["problem"]]
    if failed := [row["estimator_fault"] for row in good if row["estimator_fault"]]:
        lines.insert(0, f"WARNING: in {counted(len(failed), 'lift')} {failed[0]}")
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def trial_table(summary: "TrialSummary", simulated: str, wall_s: float, to_stderr: bool = False) -> None:
    """Print the table of errors per object, then the figures of the whole trial.

    simulated: prefix of printed results, as of `mark`. wall_s: run time.
    """
    from rig.results.metrics import mare_text
    from rig.results.notes import reaction_text, turn_distribution
    from rig.terminal.tables import table_console

    console = table_console(to_stderr)
    console.print(object_table(summary, simulated, summary.reacting.kind if summary.reacting else "none"))
    console.print(
        f"{simulated}MARE over phase B {mare_text(summary.mare_b)}; paper, on its real bench: 1.85 ± 0.96; "
        f"if refused frames keep the last angle: {mare_text(summary.mare_held)}"
    )
    console.print(turn_distribution(summary))
    if summary.reacting:
        console.print(reaction_text(summary.reacting))
    console.print(f"{wall_s:.1f} s for {summary.bench_s:.1f} s of {simulated.lower()}bench time")


def print_limits(found: "Sequence[Judged]", to_stderr: bool = False) -> None:
    """Print a row per limit; nothing without limits."""
    from rig.results.limits import LIMIT_HEADINGS, limit_rows
    from rig.terminal.tables import console_table, table_console

    if found:
        missed = sum(not one.met for one in found)
        verdict = f"{missed} of {len(found)} missed" if missed else "all kept"
        title = f"limits: {verdict}"
        table_console(to_stderr).print(console_table(LIMIT_HEADINGS, limit_rows(found), (0, 1, 3), title))


def object_table(summary: "TrialSummary", simulated: str, react: str = "none") -> "Table":
    """Return the table of errors per object.

    simulated: prefix of the title, as of `mark`. react: name of the reaction to slip.
    """
    from rig.results.metrics import HEADING, mare_text
    from rig.terminal.tables import console_table

    reacting = "" if react == "none" else f"; reaction to slip: {react}"
    title = f"{simulated}rotational error per object, degrees: {HEADING}{reacting}"
    columns = ("object", "lifts", "outcomes", "true turn", "phase B", "phases B and C", "answered")
    rows = [
        (
            each.name,
            str(each.lifts_accepted),
            each.outcomes_text,
            each.turn_text,
            mare_text(each.mare_b),
            mare_text(each.mare),
            f"{each.answered:.1%}",
        )
        for each in summary.objects
    ]
    table = console_table(columns, rows, (0, 2), title)
    table.add_section()
    figures = mare_text(summary.mare_b), mare_text(summary.mare), f"{summary.answered:.1%}"
    table.add_row("all", str(summary.lifts_accepted), "", "", *figures)
    return table
