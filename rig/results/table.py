"""Write and read tables with a row per lift: of one session (`lifts.csv`) and of many (`results.csv`).

A row has the values of the lift's row in `lifts.jsonl`. `rig.sessions.table_files.ReplayRow` declares the
columns.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

from drivers.errors import FormatError, InputError
from drivers.formats import reason
from protocols.reaction import ReactionKind
from rig.results.summary import TableLift, TrialSummary, summarize_lifts
from rig.sessions.records import ErrorSummary, FinishedLift, LiftRow, ReactionRecord
from rig.sessions.table_files import (
    IF_REACTING,
    IN_CSV,
    REPLAYS,
    Line,
    ReplayRow,
    csv_bytes,
    has_parquet,
    read_csv,
    read_parquet,
)


def _plain(hint: Any) -> type:
    """Return a column's type without the None for an empty cell."""
    return next(kind for kind in (get_args(hint) or (hint,)) if kind is not type(None))


COLUMNS = {name: _plain(hint) for name, hint in get_type_hints(ReplayRow).items() if name[0] != "_"}
"""Columns in order, with their types."""
NEEDED = ("session", "object", "accepted", "re_mean_deg")
"""Columns that a results table must have."""
ERRORS = ("re_b", "re", "re_held")
"""Errors of a lift: over phase B, over phases B and C, over both with refused frames held."""
_REACTION_TIMES = ("onset_s", "event_s", "command_s", "standstill_s")


@dataclass(frozen=True, slots=True)
class TableHead:
    """First columns of a lift's row: its session and its estimator."""

    session: str
    started: str
    bench: str
    estimator: str
    window: int


def table_row(
    head: TableHead, row: LiftRow, identical: bool | None = None, problem: str | None = None
) -> ReplayRow:
    """Return a lift's row as a row of a table. identical, problem: see `ReplayRow`."""
    return replace(_line(row), **asdict(head), identical=identical, problem=problem)


def lifts_csv(rows: Sequence[LiftRow]) -> bytes:
    """Return the lifts of one session as CSV, with a row per attempt."""
    reacts = any(row.react is not ReactionKind.NONE for row in rows)
    columns = {
        each.name: COLUMNS[each.name]
        for each in fields(ReplayRow)
        if each.metadata.get("in_csv") in ((IN_CSV, IF_REACTING) if reacts else (IN_CSV,))
    }
    return csv_bytes(columns, [{**asdict(_line(row)), "accepted": str(row.accepted)} for row in rows])


def _line(row: LiftRow) -> ReplayRow:
    """Return a lift's row as a row of a table, without the columns of its session."""
    values: dict[str, Any] = {name: getattr(row, name) for name in COLUMNS if hasattr(row, name)}
    for part in ERRORS:
        if (error := getattr(row, part, None)) is not None:
            values |= {f"{part}_{key}": value for key, value in asdict(error).items()}
    if isinstance(row, FinishedLift):
        values["warnings"] = "; ".join(row.warnings) or None
        values["estimator_fault"] = str(row.estimator_faults) if row.estimator_faults else None
        values |= _reaction_cells(row.reactions)
    return ReplayRow(**{**values, "session": "", "react": row.react.value})


def _reaction_cells(reactions: tuple[ReactionRecord, ...] | None) -> dict[str, object]:
    """Return the number of reactions, the steps that they added to the grip, and the times of the first."""
    if reactions is None:
        return {"reactions": None}
    first = reactions[0] if reactions else None
    return {
        "reactions": len(reactions),
        "counts_added": sum(reaction.counts_added for reaction in reactions),
        **{f"reaction_{key}": getattr(first, key, None) for key in _REACTION_TIMES},
    }


def unread_row(head: TableHead, row: LiftRow, problem: str) -> ReplayRow:
    """Return the row of a lift whose recording cannot be read. problem: the reason."""
    named = {
        name: getattr(row, name) for name in ("number", "attempt", "object", "name", "lift", "simulated")
    }
    return ReplayRow(**asdict(head), **named, accepted=False, problem=problem)


def broken_row(session: str, problem: str) -> ReplayRow:
    """Return the row of a session that cannot be read at all. problem: the reason."""
    return ReplayRow(session=session, number=0, attempt=0, accepted=False, problem=problem)


def table_lines(rows: Sequence[ReplayRow]) -> list[Line]:
    """Return rows as the lines of a table."""
    return [asdict(row) for row in rows]


def table_lift(row: ReplayRow) -> TableLift:
    """Return the fields of a row that a summary needs. Raises `InputError` if one of them is empty."""
    needed: dict[str, Any] = {
        key: getattr(row, key) for key in ("object", "name", "lift", "outcome", "answered")
    }
    empty = [key for key, value in needed.items() if value is None]
    if empty:
        raise InputError(
            f"session {row.session}, lift {row.number}: {', '.join(empty)} is empty in the table"
        )
    needed |= {part: _error(row, part) for part in ERRORS}
    return TableLift(**needed, final_truth_deg=row.final_truth_deg)


def summarize_table(rows: Sequence[ReplayRow]) -> TrialSummary:
    """Summarize the lifts of a table. Raises `InputError` as `table_lift` does."""
    return summarize_lifts([table_lift(row) for row in rows], sum(row.bench_s or 0.0 for row in rows))


def by_reaction(rows: Sequence[ReplayRow]) -> dict[str, list[ReplayRow]]:
    """Return the rows by reaction to slip; those without reaction come first."""
    kinds = sorted({row.react or "none" for row in rows}, key=lambda kind: (kind != "none", kind))
    return {kind: [row for row in rows if (row.react or "none") == kind] for kind in kinds}


def results_json(rows: Sequence[ReplayRow]) -> dict[str, object]:
    """Return the figures of a table for JSON output.

    Lifts that react to slip turn less. If a table has lifts with and without reaction, the figures are those
    of lifts without reaction, and `by_reaction` has the figures of each reaction.
    """
    good = [row for row in rows if row.measured]
    asked = [row.identical for row in good if row.identical is not None]
    apart = {kind: summarize_table(own).as_json() for kind, own in by_reaction(good).items()}
    return {
        "simulated": any(row.simulated for row in good),
        "estimators": sorted({str(row.estimator) for row in good}),
        "sessions": len({row.session for row in good}),
        "broken": [{"session": row.session, "problem": row.problem} for row in rows if row.problem],
        "identical": sum(asked) if asked else None,
        **next(iter(apart.values()), summarize_table(()).as_json()),
        **({"by_reaction": apart} if len(apart) > 1 else {}),
    }


def read_results(path: Path) -> list[ReplayRow]:
    """Read a results table, `.csv` or `.parquet`. path: the file, or the folder that holds it.

    Raises `InputError` for another file, or for a table without the columns that a summary needs.
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
        what = f"has no column {', '.join(missing)}" if missing else "has no rows"
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
        f"{folder}: has no results.csv or results.parquet; make one: rig replay SESSIONS... --out DIR"
    )
