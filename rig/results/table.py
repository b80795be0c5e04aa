"""One table of lifts out of many sessions: a line per lift, as CSV and as Parquet.

A line is a flat copy of a lift's row in `lifts.jsonl`, with its session in front; errors are in
degrees, times in seconds.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

from drivers.errors import FormatError, InputError
from drivers.formats import reason
from rig.results.summary import TrialSummary, flat_errors, summarize_lifts
from rig.sessions.records import REPLAYS, ErrorSummary, FinishedLift, LiftRow, ReplayRow
from rig.sessions.table_files import Line, has_parquet, read_csv, read_parquet


def _plain(hint: Any) -> type:
    """Return a column's type without the None that stands for an empty cell."""
    return next(kind for kind in (get_args(hint) or (hint,)) if kind is not type(None))


COLUMNS = {name: _plain(hint) for name, hint in get_type_hints(ReplayRow).items() if name[0] != "_"}
"""Columns in their order, with their types."""
NEEDED = ("session", "object", "accepted", "re_mean_deg")
_EMPTY = ReplayRow(**{**dict.fromkeys(COLUMNS), "session": "", "accepted": False})


@dataclass(frozen=True, slots=True)
class TableHead:
    """What stands in front of a lift's row: its session, and what looked at it."""

    session: str
    started: str
    bench: str
    estimator: str
    window: int


@dataclass(frozen=True, slots=True)
class TableLift:
    """A lift of a table as far as a summary needs it, see `rig.results.summary.MeasuredLift`."""

    object: str
    name: str
    lift: int
    outcome: str
    re_b: ErrorSummary | None
    re: ErrorSummary | None
    re_held: ErrorSummary | None
    answered: float
    final_truth_deg: float | None


def table_row(
    head: TableHead, row: LiftRow, identical: bool | None = None, problem: str | None = None
) -> ReplayRow:
    """Return a lift's row as a line of the table. identical, problem: see `ReplayRow`."""
    known = {name: getattr(row, name) for name in COLUMNS if hasattr(row, name)}
    faults = row.estimator_faults if isinstance(row, FinishedLift) else None
    told = {"identical": identical, "problem": problem, "estimator_fault": str(faults) if faults else None}
    return replace(_EMPTY, **asdict(head), **known, **flat_errors(row), **told)


def unread_row(head: TableHead, row: LiftRow, problem: str) -> ReplayRow:
    """Return the line of a lift whose recording cannot be read: which one it is, and why."""
    named = {
        name: getattr(row, name) for name in ("number", "attempt", "object", "name", "lift", "simulated")
    }
    return replace(_EMPTY, **asdict(head), **named, problem=problem)


def broken_row(session: str, problem: str) -> ReplayRow:
    """Return the line of a session that cannot be read as a whole."""
    return replace(_EMPTY, session=session, number=0, attempt=0, problem=problem)


def table_lines(rows: Sequence[ReplayRow]) -> list[Line]:
    """Return rows as the lines of a table."""
    return [asdict(row) for row in rows]


def table_lift(row: ReplayRow) -> TableLift:
    """Return what a summary needs of a line. Raises `InputError` naming the column that is empty."""
    needed = {key: getattr(row, key) for key in ("object", "name", "lift", "outcome", "answered")}
    empty = [key for key, value in needed.items() if value is None]
    if empty:
        raise InputError(f"session {row.session}, lift {row.number}: no {', '.join(empty)} in the table")
    return TableLift(
        **needed,
        re_b=_error(row, "re_b"),
        re=_error(row, "re"),
        re_held=_error(row, "re_held"),
        final_truth_deg=row.final_truth_deg,
    )


def summarize_table(rows: Sequence[ReplayRow]) -> TrialSummary:
    """Summarize the lifts of a table. Raises `InputError` as `table_lift` does."""
    return summarize_lifts([table_lift(row) for row in rows], sum(row.bench_s or 0.0 for row in rows))


def read_results(path: Path) -> list[ReplayRow]:
    """Read a results table, `.csv` or `.parquet`, or that of a folder which holds one.

    Raises `InputError` for another file, or one without the columns that a summary needs.
    """
    file = _table_in(path) if path.is_dir() else path
    try:
        raw = read_parquet(file) if file.suffix == ".parquet" else read_csv(file, COLUMNS)
    except FormatError:
        raise
    except (OSError, ValueError, MemoryError) as error:
        raise InputError(f"{file}: cannot be read as a results table ({reason(error)})") from error
    missing = [column for column in NEEDED if raw and column not in raw[0]]
    if missing or not raw:
        what = f"has no column {', '.join(missing)}" if missing else "holds no line"
        raise InputError(
            f"{file}: {what}; give the results.csv or results.parquet of `rig replay SESSIONS...`"
        )
    return [_row(line, f"{file}: row {number}") for number, line in enumerate(raw, start=1)]


def _row(line: Line, where: str) -> ReplayRow:
    try:
        return REPLAYS.checked({column: line.get(column) for column in COLUMNS})
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def _error(row: ReplayRow, part: str) -> ErrorSummary | None:
    values = [getattr(row, f"{part}_{field.name}") for field in fields(ErrorSummary)]
    return None if None in values else ErrorSummary(*values)


def _table_in(folder: Path) -> Path:
    for name in ("results.parquet", "results.csv"):
        if (folder / name).exists() and (name.endswith(".csv") or has_parquet()):
            return folder / name
    raise InputError(
        f"{folder}: holds no results.csv or results.parquet; make one: rig replay SESSIONS... --out DIR"
    )
