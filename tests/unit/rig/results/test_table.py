"""The table of many lifts: the same from CSV and Parquet, back to rows, and quick to summarize."""

import random
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import InputError
from rig.results.summary import summarize_trial
from rig.results.table import COLUMNS, flat_row, nested_row, read_results
from rig.sessions.table_files import csv_bytes, parquet_bytes


def row(number: int, error_deg: float | None) -> dict[str, Any]:
    errors = None
    if error_deg is not None:
        errors = {"mean_deg": error_deg, "std_deg": 0.1, "max_deg": 2 * error_deg, "frames": 300}
    return {
        "number": number, "attempt": 0, "object": f"t{number % 3}", "name": "tool, long", "lift": number,
        "position": "left", "accepted": True, "outcome": "slipped", "grip_counts": 4, "lift_height_m": 0.03,
        "final_estimate_deg": -7.25, "final_truth_deg": -7.5, "onset_truth_s": 0.5, "onset_estimate_s": None,
        "onset_alarm_s": None, "answered": 1.0, "bench_s": 13.5, "simulated": True,
        "re": errors, "re_b": errors, "re_held": errors,
    }  # fmt: skip


def table(count: int) -> list[dict[str, Any]]:
    chance = random.Random(0)
    rows = [row(n, chance.uniform(0.1, 3.0) if n % 7 else None) for n in range(count)]
    head = {"session": "/s/one", "started": "2026-11-21", "bench": "fake", "estimator": "slip", "window": 1}
    return [flat_row(r, **head, identical=bool(r["number"] % 2)) for r in rows]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_is_read_back_as_it_was_written(kind: str, tmp_path: Path) -> None:
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    lines = [
        *table(20),
        flat_row({}, session="/s/two", number=0, attempt=0, accepted=False, problem='no, "x"'),
    ]
    path = tmp_path / f"results.{kind}"
    path.write_bytes(csv_bytes(COLUMNS, lines) if kind == "csv" else parquet_bytes(COLUMNS, lines))
    assert read_results(path) == lines
    assert read_results(tmp_path) == lines


def test_the_summary_of_a_table_is_that_of_its_rows() -> None:
    rows = [row(n, 0.5 + 0.1 * n if n % 7 else None) for n in range(20)]
    again = [nested_row(flat_row(r, session="s")) for r in rows]
    assert summarize_trial(again) == summarize_trial(rows)


def test_a_file_that_is_no_results_table_is_refused(tmp_path: Path) -> None:
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
