"""`rig results`: a results table of many lifts, summarized."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli.common import JsonOption, emit_json

Line = dict[str, Any]


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

    lines = read_results(table)
    print_results(lines, by, to_stderr=json)
    if json:
        emit_json({"table": str(table), **results_json(lines)})


def print_results(lines: list[Line], by: str, to_stderr: bool) -> None:
    """Print the summary of a table's lines by object or by session, then what was broken."""
    from rig.cli.printing import object_table, table_console

    console = table_console(to_stderr)
    good = [line for line in lines if not line["problem"]]
    if by == By.OBJECT and good:
        console.print(object_table(_summary(good), _mark(good)))
    elif good:
        console.print(_session_table(good))
    estimators = ", ".join(sorted({str(line["estimator"]) for line in good})) or "none"
    identical = sum(line["identical"] is True for line in good)
    console.print(
        f"estimator {estimators}; {identical} of {len(good)} lifts exactly as stored", highlight=False
    )
    for line in lines:
        if line["problem"]:
            console.print(f"broken: {line['problem']}", highlight=False, soft_wrap=True, markup=False)


def results_json(lines: list[Line]) -> dict[str, Any]:
    """Return a table's figures under the contract's names."""
    from rig.cli.printing import summary_json

    good = [line for line in lines if not line["problem"]]
    return {
        "simulated": bool(_mark(good)),
        "estimators": sorted({line["estimator"] for line in good}),
        "sessions": len({line["session"] for line in good}),
        "broken": [
            {"session": line["session"], "problem": line["problem"]} for line in lines if line["problem"]
        ],
        "identical": sum(line["identical"] is True for line in good),
        **summary_json(_summary(good)),
    }


def line_note(line: Line) -> str:
    """Say in a few words what came of one lift of one session."""
    from rig.cli.printing import lift_note

    where = Path(line["session"]).name
    return f"{where}: {line['problem']}" if line["problem"] else f"{where}: {lift_note(_nested(line))}"


def _session_table(lines: list[Line]) -> Any:
    from rich.table import Table

    from rig.cli.printing import mare_text

    table = Table(title=f"{_mark(lines)}MARE per session, degrees: mean +- std [95 % interval]")
    for heading in ("session", "estimator", "lifts", "phase B", "phases B and C", "answered"):
        table.add_column(heading, justify="left" if heading in ("session", "estimator") else "right")
    for session in dict.fromkeys(line["session"] for line in lines):
        own = [line for line in lines if line["session"] == session]
        summary = _summary(own)
        table.add_row(
            Path(session).name, ", ".join({line["estimator"] for line in own}), str(len(own)),
            mare_text(summary.mare_b), mare_text(summary.mare), f"{summary.answered:.1%}",
        )  # fmt: skip
    return table


def _summary(lines: list[Line]) -> Any:
    from rig.results.summary import summarize_trial

    return summarize_trial([_nested(line) for line in lines])


def _nested(line: Line) -> Line:
    from rig.results.table import nested_row

    return nested_row(line)


def _mark(lines: list[Line]) -> str:
    return "SIMULATED " if any(line["simulated"] for line in lines) else ""
