"""`rig benchmark sessions`: how long many sessions take to be listed, and a long one to be opened."""

import tempfile
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.common import JsonOption, emit_json, say
from rig.cli.places import folder_place


def sessions(
    count: Annotated[int, typer.Option("--sessions", min=1, max=10000, help="Sessions to list.")] = 1000,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=1000, help="Lifts of each.")] = 45,
    long: Annotated[int, typer.Option("--long", min=1, max=10000, help="Lifts of the one to open.")] = 1000,
    runs: Annotated[int, typer.Option("--runs", min=1, max=20, help="Runs; the quickest counts.")] = 3,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Keep the made sessions here, for the next time.", callback=folder_place),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Time `rig sessions` on 1,000 made sessions of 45 lifts, and opening one of 1,000 lifts.

    The sessions have the files of real ones, their recordings sparse. Exit code 4 when a limit was missed.

    Examples:
      rig benchmark sessions

      rig benchmark sessions --sessions 200 --out made --json

    """
    from rig.benchmark.sessions.benchmark import run_sessions
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table

    with (
        tempfile.TemporaryDirectory(prefix="rig-sessions-") if out is None else nullcontext(str(out)) as place
    ):
        found = run_sessions(Path(place), count, lifts, long, runs, say)
    columns = ("whole processes, made sessions", "quickest, s", "slowest, s", "asked, s", "")
    rows = [
        (
            f.what,
            f"{min(f.runs_s):.2f}",
            f"{max(f.runs_s):.2f}",
            f.limit.asked,
            "kept" if f.limit.met else "MISSED",
        )
        for f in found
    ]
    table_console(json).print(console_table(columns, rows))
    if json:
        emit_json({"timed": [asdict(f) for f in found]})
    exit_where_missed(f.limit for f in found)
