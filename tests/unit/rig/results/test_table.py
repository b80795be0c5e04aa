"""The table of many lifts: equal in CSV and Parquet, convertible to rows, and summarised quickly."""

import random
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.report.trial_page import lift_table
from rig.results.summary import summarize_trial
from rig.results.table import COLUMNS, REPLAYS, broken_row, lifts_csv, summarize_table, table_row
from rig.sessions.codec import json_value
from rig.sessions.records import IN_CSV, ErrorSummary, Lift
from rig.sessions.table_files import Line, csv_bytes, parquet_bytes, pyarrow_modules
from support.tables import read_typed_csv

HEAD: Line = {
    "session": "/s/one", "started": "2026-11-21", "bench": "fake", "estimator": "slip", "window": 1,
}  # fmt: skip
MakeRow = Callable[..., Lift]


def row(make: MakeRow, number: int, error_deg: float | None) -> Lift:
    error = None if error_deg is None else ErrorSummary(error_deg, 0.1, 2 * error_deg, 300)
    return make(number, object=f"t{number % 3}", name="tool, long", re=error, re_b=error, re_held=error)


def table(make: MakeRow, count: int) -> list[Line]:
    chance = random.Random(0)
    rows = [row(make, n, chance.uniform(0.1, 3.0) if n % 7 else None) for n in range(count)]
    return [table_row(HEAD, r, r if r.number % 2 else replace(r, answered=0.5)) for r in rows]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_written_table_is_read_back_unchanged(kind: str, tmp_path: Path, lift_row: MakeRow) -> None:
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    rows = [*table(lift_row, 20), broken_row("/s/two", 'no, "x"')]
    path = tmp_path / f"results.{kind}"
    path.write_bytes(csv_bytes(COLUMNS, rows) if kind == "csv" else parquet_bytes(COLUMNS, rows))
    if kind == "csv":
        assert read_typed_csv(path, COLUMNS) == rows
    else:
        assert pyarrow_modules()[1].read_table(path).to_pylist() == rows


def test_summary_of_a_table_equals_that_of_its_rows(lift_row: MakeRow) -> None:
    rows = [row(lift_row, n, 0.5 + 0.1 * n if n % 7 else None) for n in range(20)]
    assert summarize_table([table_row(HEAD, r) for r in rows]) == summarize_trial(rows)


def test_empty_or_invalid_cell_is_named(lift_row: MakeRow) -> None:
    line = table(lift_row, 1)[0]
    with pytest.raises(ValueError, match="'session' is missing"):
        REPLAYS.parse_values({**line, "session": None})
    with pytest.raises(InputError, match="lift 0: answered is empty"):
        summarize_table([{**line, "answered": None}])


def test_declared_values_of_a_lift_are_in_line_tables_and_report(lift_row: MakeRow) -> None:
    lift = row(lift_row, 1, 0.5)
    line, report = json_value(lift), lift_table([lift])
    table = lifts_csv([lift]).decode().splitlines()[0].split(",")
    for value in fields(Lift):
        if tables := value.metadata.get("tables"):
            columns = [name for name in COLUMNS if name == value.name or name.startswith(f"{value.name}_")]
            assert columns, value.name
            assert bool(set(columns) & set(table)) == (tables == IN_CSV), value.name
        if {"stored", "figure"} <= value.metadata.keys():
            assert value.name in line
        for shown in value.metadata.get("shown", ()):
            assert report.rows[0][list(report.columns).index(shown.heading)] == shown.text(lift)
    assert report.columns[2:5] == ("outcome", "grasp", "grip")
