"""One table of lifts out of many sessions: a line per lift, as CSV and as Parquet.

A line is a flat copy of a lift's row in `lifts.jsonl`, with its session in front; errors are in
degrees, times in seconds. `nested_row` makes the row again, so that one code summarizes both.
"""

from pathlib import Path
from typing import Any

from drivers.errors import InputError
from rig.sessions.table_files import has_parquet, read_csv, read_parquet

ERRORS = ("re_b", "re", "re_held")
COLUMNS: dict[str, type] = {
    "session": str, "started": str, "bench": str, "simulated": bool, "estimator": str, "window": int,
    "number": int, "attempt": int, "object": str, "name": str, "lift": int, "position": str,
    "accepted": bool, "outcome": str, "grip_counts": int, "lift_height_m": float,
    "final_estimate_deg": float, "final_truth_deg": float,
    "onset_truth_s": float, "onset_estimate_s": float, "onset_alarm_s": float,
    "answered": float, "bench_s": float, "identical": bool, "problem": str,
    **{f"{part}_{key}": kind for part in ERRORS
       for key, kind in (("mean_deg", float), ("std_deg", float), ("max_deg", float), ("frames", int))},
}  # fmt: skip
"""Columns in their order. `identical`: the replay gave exactly the stored row. `problem`: what kept
a lift, or a whole session, from being read; the figures are empty then."""
NEEDED = ("session", "object", "accepted", "re_mean_deg")


def flat_row(row: dict[str, Any], **head: Any) -> dict[str, Any]:
    """Return a lift's row as a line of the table. head: the columns that the row does not have."""
    errors = {f"{part}_{key}": value for part in ERRORS for key, value in (row.get(part) or {}).items()}
    known = {**row, **errors, **head}
    return {column: known.get(column) for column in COLUMNS}


def nested_row(line: dict[str, Any]) -> dict[str, Any]:
    """Return a line of the table as a lift's row, as far as `rig.results.summary` needs it."""
    parts = {
        part: {key: line[f"{part}_{key}"] for key in ("mean_deg", "std_deg", "max_deg", "frames")}
        if line[f"{part}_mean_deg"] is not None
        else None
        for part in ERRORS
    }
    return {**line, **parts}


def read_results(path: Path) -> list[dict[str, Any]]:
    """Read a results table, `.csv` or `.parquet`, or that of a folder which holds one.

    Raises `InputError` for another file, or one without the columns that a summary needs.
    """
    file = _table_in(path) if path.is_dir() else path
    try:
        raw = read_parquet(file) if file.suffix == ".parquet" else read_csv(file, COLUMNS)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read as a results table ({error})") from error
    missing = [column for column in NEEDED if raw and column not in raw[0]]
    if missing or not raw:
        what = f"has no column {', '.join(missing)}" if missing else "holds no line"
        raise InputError(
            f"{file}: {what}; give the results.csv or results.parquet of `rig replay SESSIONS...`"
        )
    return [{column: line.get(column) for column in COLUMNS} for line in raw]


def _table_in(folder: Path) -> Path:
    for name in ("results.parquet", "results.csv"):
        if (folder / name).exists() and (name.endswith(".csv") or has_parquet()):
            return folder / name
    raise InputError(
        f"{folder}: holds no results.csv or results.parquet; make one: rig replay SESSIONS... --out DIR"
    )
