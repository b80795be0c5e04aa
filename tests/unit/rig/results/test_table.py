"""The table of many lifts: equal in CSV and Parquet, convertible to rows, and summarised quickly."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.results.summary import summarize_trial
from rig.results.table import (
    COLUMNS,
    TableHead,
    broken_row,
    read_results,
    summarize_table,
    table_lines,
    table_row,
)
from rig.sessions.records import ErrorSummary, FinishedLift
from rig.sessions.table_files import ReplayRow, csv_bytes, parquet_bytes

HEAD = TableHead("/s/one", "2026-11-21", "fake", "slip", 1)
MakeRow = Callable[..., FinishedLift]


def row(make: MakeRow, number: int, error_deg: float | None) -> FinishedLift:
    error = None if error_deg is None else ErrorSummary(error_deg, 0.1, 2 * error_deg, 300)
    return make(number, object=f"t{number % 3}", name="tool, long", re=error, re_b=error, re_held=error)


def table(make: MakeRow, count: int) -> list[ReplayRow]:
    chance = random.Random(0)
    rows = [row(make, n, chance.uniform(0.1, 3.0) if n % 7 else None) for n in range(count)]
    return [table_row(HEAD, r, identical=bool(r.number % 2)) for r in rows]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_written_table_is_read_back_unchanged(kind: str, tmp_path: Path, lift_row: MakeRow) -> None:
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    rows = [*table(lift_row, 20), broken_row("/s/two", 'no, "x"')]
    lines = table_lines(rows)
    path = tmp_path / f"results.{kind}"
    path.write_bytes(csv_bytes(COLUMNS, lines) if kind == "csv" else parquet_bytes(COLUMNS, lines))
    assert read_results(path) == rows
    assert read_results(tmp_path) == rows


def test_summary_of_a_table_equals_that_of_its_rows(lift_row: MakeRow) -> None:
    rows = [row(lift_row, n, 0.5 + 0.1 * n if n % 7 else None) for n in range(20)]
    assert summarize_table([table_row(HEAD, r) for r in rows]) == summarize_trial(rows)


def test_empty_or_invalid_cell_is_named(tmp_path: Path, lift_row: MakeRow) -> None:
    lines = table_lines(table(lift_row, 3))
    path = tmp_path / "results.csv"
    path.write_bytes(csv_bytes(COLUMNS, [lines[0], {**lines[1], "session": None}]))
    with pytest.raises(InputError, match=r"results\.csv: row 2: 'session'"):
        read_results(path)
    path.write_bytes(csv_bytes(COLUMNS, [{**lines[0], "answered": None}]))
    with pytest.raises(InputError, match="lift 0: answered is empty"):
        summarize_table(read_results(path))


def test_file_without_a_results_table_is_rejected(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("frame,t_s\n1,0.5\n")
    with pytest.raises(InputError, match="no column session"):
        read_results(other)
    other.write_bytes(b"\x00\xff\x00rubbish")
    with pytest.raises(InputError, match=r"other\.csv"):
        read_results(other)
    with pytest.raises(InputError, match=r"rig replay SESSIONS"):
        read_results(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_results(tmp_path / "nothing.csv")
