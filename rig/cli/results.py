"""`rig results`: a results table of many lifts, summarized."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.common import JsonOption, emit_json

if TYPE_CHECKING:
    from rich.table import Table

    from rig.sessions.table_files import ReplayRow


class By(StrEnum):
    """What the lines of a summary stand for."""

    OBJECT = "object"
    SESSION = "session"


def results(
    table: Annotated[
        Path, typer.Argument(help="results.csv, results.parquet, or the folder of `rig replay SESSIONS...`.")
    ],
    by: Annotated[By, typer.Option("--by", help="A line per object or per session.")] = By.OBJECT,
    json: JsonOption = False,
) -> None:
    """Summarize a results table: MARE with intervals, what was identical, what was broken.

    Examples:
      rig results sessions/ellipse

      rig results sessions/ellipse/results.csv --by session --json

    """
    from rig.results.table import read_results

    rows = read_results(table)
    print_results(rows, by, to_stderr=json)
    if json:
        emit_json({"table": str(table), **results_json(rows)})


def print_results(rows: "list[ReplayRow]", by: str, to_stderr: bool) -> None:
    """Print the summary of a table's rows by object or by session, then what was broken."""
    from rig.cli.fitting import table_console
    from rig.cli.printing import object_table
    from rig.results.table import summarize_table

    console = table_console(to_stderr)
    good = [row for row in rows if row.measured]
    if by == By.OBJECT and good:
        for react, own in _by_reaction(good).items():
            console.print(object_table(summarize_table(own), _mark(own), react))
    elif good:
        console.print(_session_table(good))
    estimators = ", ".join(sorted({str(row.estimator) for row in good})) or "none"
    asked = [row.identical for row in good if row.identical is not None]
    same = f"; {sum(asked)} of {counted(len(asked), 'lift')} exactly as stored" if asked else ""
    console.print(f"estimator {estimators}{same}", highlight=False)
    failed = [row.estimator_fault for row in good if row.estimator_fault]
    if failed:
        text = f"WARNING: in {counted(len(failed), 'lift')} {failed[0]}"
        console.print(text, highlight=False, soft_wrap=True)
    for row in rows:
        if row.problem:
            console.print(f"broken: {row.problem}", highlight=False, soft_wrap=True)


def results_json(rows: "list[ReplayRow]") -> dict[str, object]:
    """Return a table's figures under the contract's names.

    Lifts that react to slip turn less: of a table with both kinds the figures are of those without reaction,
    and `by_reaction` has each kind's.
    """
    from rig.cli.printing import summary_json
    from rig.results.table import summarize_table

    good = [row for row in rows if row.measured]
    apart = _by_reaction(good)
    mixed = len(apart) > 1
    return {
        "simulated": bool(_mark(good)),
        "estimators": sorted({str(row.estimator) for row in good}),
        "sessions": len({row.session for row in good}),
        "broken": [{"session": row.session, "problem": row.problem} for row in rows if row.problem],
        "identical": _identical(good),
        **summary_json(summarize_table(next(iter(apart.values()), good))),
        **(
            {"by_reaction": {r: summary_json(summarize_table(own)) for r, own in apart.items()}}
            if mixed
            else {}
        ),
    }


def _by_reaction(rows: "list[ReplayRow]") -> "dict[str, list[ReplayRow]]":
    """Return rows by what was done about slip, those without reaction first."""
    kinds = sorted({row.react or "none" for row in rows}, key=lambda kind: (kind != "none", kind))
    return {kind: [row for row in rows if (row.react or "none") == kind] for kind in kinds}


def _identical(rows: "list[ReplayRow]") -> int | None:
    """How many rows are exactly as stored, of those that are to be; None where none is."""
    asked = [row.identical for row in rows if row.identical is not None]
    return sum(asked) if asked else None


def row_note(row: "ReplayRow") -> str:
    """Say in a few words what came of one lift of one session."""
    from rig.cli.printing import lift_note
    from rig.results.table import table_lift

    where = Path(row.session).name
    if row.problem:
        return f"{where}: {row.problem}"
    amiss = f", WARNING: {row.estimator_fault}" if row.estimator_fault else ""
    return f"{where}: {lift_note(table_lift(row))}{amiss}"


def _session_table(rows: "list[ReplayRow]") -> "Table":
    from rich.table import Table

    from rig.results.metrics import HEADING, mare_text
    from rig.results.table import summarize_table

    table = Table(title=f"{_mark(rows)}MARE per session, degrees: {HEADING}")
    for heading in ("session", "estimator", "reaction", "lifts", "phase B", "phases B and C", "answered"):
        table.add_column(
            heading, justify="left" if heading in ("session", "estimator", "reaction") else "right"
        )
    for session in dict.fromkeys(row.session for row in rows):
        own = [row for row in rows if row.session == session]
        summary = summarize_table(own)
        table.add_row(
            Path(session).name, ", ".join({str(row.estimator) for row in own}), ", ".join(_by_reaction(own)),
            str(len(own)),
            mare_text(summary.mare_b), mare_text(summary.mare), f"{summary.answered:.1%}",
        )  # fmt: skip
    return table


def _mark(rows: "list[ReplayRow]") -> str:
    return "SIMULATED " if any(row.simulated for row in rows) else ""
