"""Tables are never cut, on terminals of any width and in other output."""

import io
import re
from dataclasses import replace

import pytest
from rich.table import Table

from rig.cli.results import object_table
from rig.results.metrics import Mare
from rig.results.summary import TrialSummary
from rig.terminal.tables import UNBOUNDED, PlainConsole

NAME = "2026-11-22T143431_a_long_name_of_a_session_trial"
ROW = (NAME, "12", "9 slipped, 2 fallen, 1 still", "0.20 ± 0.15 [0.11, 0.33]", "100.0%")
HEADINGS = ("session", "lifts", "outcomes", "phases B and C", "answered")


def printed(table: Table, width: int) -> str:
    stream = io.StringIO()
    console = PlainConsole(file=stream, width=width)
    console.print(table)
    return stream.getvalue()


def words(text: str) -> list[str]:
    return re.sub(r"[│┃║━─┏┓┗┛┡┩┳┻╇╈├┤┼┴└┘;]+", " ", text).split()


@pytest.mark.parametrize("width", [40, 60, 80, 100, 140, UNBOUNDED])
def test_no_word_is_cut_or_lost_at_any_width(width: int) -> None:
    table = Table(*HEADINGS, title="a table")
    for _ in range(3):
        table.add_row(*ROW)
    text = printed(table, width)
    assert "…" not in text
    lines = [line.rstrip() for line in text.splitlines()]
    assert max(map(len, lines)) <= max(width, len(NAME))
    found = words(text)
    for word in " ".join(ROW).replace(";", " ").split():
        assert found.count(word) >= 3, f"{word} at {width}:\n{text}"
    assert found.count(NAME) == 3


def test_row_is_one_line_without_a_terminal() -> None:
    table = Table(*HEADINGS)
    table.add_row(*(f"{cell} " * 10 for cell in ROW))
    text = printed(table, UNBOUNDED)
    assert sum(NAME in line for line in text.splitlines()) == 1


def test_paper_table_fits_80_columns() -> None:
    mare = Mare(0.2, 0.15, 0.11, 0.33, 5)
    row = TrialSummary(
        name="t4 plastic spatula", objects=(), lifts_accepted=5, outcomes={"slipped": 4, "fallen": 1},
        turns_deg=(-28.0, 27.0), mare=mare, mare_b=mare, mare_held=mare, answered=1.0, bench_s=1.0,
    )  # fmt: skip
    summary = replace(row, name="all", objects=(row,))
    text = printed(object_table(summary, "SIMULATED "), 80)
    assert "┃" in text
    assert max(map(len, text.splitlines())) <= 80
    assert {"plastic", "slipped,", "fallen", "-28", "+27", "[0.11,", "0.33]", "100.0%"} <= set(words(text))
