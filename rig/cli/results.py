"""The tables of results that commands print: of a trial, of replays of many sessions, of limits."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import plural
from rig.cli.common import mark

if TYPE_CHECKING:
    from rich.table import Table

    from rig.results.limits import Judged
    from rig.results.summary import TrialSummary
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.table_files import Line


def print_results(rows: "list[Line]", to_stderr: bool, stored: "Sequence[TrialManifest]" = ()) -> None:
    """Print the summary of a table's rows by session, then the broken sessions.

    stored: see `agreement_text`.
    """
    from rig.results.metrics import HEADING, mare_text
    from rig.results.notes import agreement_text
    from rig.results.table import agreement, by_reaction, has_figures, summarize_table
    from rig.terminal.tables import console_table, table_console

    console = table_console(to_stderr)
    good = [row for row in rows if has_figures(row)]
    if good:
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
        lines.insert(0, f"WARNING: in {plural(len(failed), 'lift')} {failed[0]}")
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def trial_table(
    summary: "TrialSummary", simulated: str, wall_s: float, to_stderr: bool = False, earlier_s: float = 0.0
) -> None:
    """Print the table of errors per object, then the figures of the whole trial.

    simulated: prefix of printed results, as of `mark`. wall_s: run time of this command. earlier_s: bench
    time of the attempts before it, if the trial was resumed.
    """
    from rig.results.metrics import mare_text
    from rig.results.notes import reaction_text, turn_distribution
    from rig.terminal.tables import table_console

    console = table_console(to_stderr)
    console.print(object_table(summary, simulated))
    console.print(
        f"{simulated}MARE over phase B {mare_text(summary.mare_b)}; paper, on its real bench: 1.85 ± 0.96; "
        f"if refused frames keep the last angle: {mare_text(summary.mare_held)}"
    )
    console.print(turn_distribution(summary))
    if summary.reacting:
        console.print(reaction_text(summary.reacting))
    now_s, unit = summary.bench_s - earlier_s, f"s of {simulated.lower()}bench time"
    earlier = f"; before it was resumed: {earlier_s:.1f} {unit}" if earlier_s else ""
    console.print(f"{wall_s:.1f} s for {now_s:.1f} {unit}{earlier}")


def print_limits(found: "Sequence[Judged]", to_stderr: bool = False) -> None:
    """Print a row per limit; nothing without limits."""
    from rig.results.limits import LIMIT_HEADINGS, limit_rows
    from rig.terminal.tables import console_table, table_console

    if found:
        missed = sum(not one.met for one in found)
        verdict = f"{missed} of {len(found)} missed" if missed else "all kept"
        title = f"limits: {verdict}"
        table_console(to_stderr).print(console_table(LIMIT_HEADINGS, limit_rows(found), (0, 1, 3), title))


def object_table(summary: "TrialSummary", simulated: str) -> "Table":
    """Return the table of errors per object.

    simulated: prefix of the title, as of `mark`.
    """
    from rig.results.metrics import HEADING, mare_text
    from rig.terminal.tables import console_table

    reacting = f"; reaction to slip: {summary.reacting.kind}" if summary.reacting else ""
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
