"""Tables with a row per lift: of one session (`lifts.csv`) and of many (`results.csv`).

`rig.sessions.records.Lift` declares the columns of a lift. A row is a dict by column, None if unknown.
"""

from collections.abc import Iterable, Sequence
from dataclasses import fields
from math import isfinite
from typing import NamedTuple

import numpy as np

from drivers.errors import InputError
from drivers.formats import quote
from protocols.reaction import ReactionKind
from rig.results.summary import TrialSummary, summarize_lifts
from rig.sessions.codec import Codec
from rig.sessions.manifest import TrialManifest
from rig.sessions.records import (
    IF_REACTING,
    IN_CSV,
    ErrorSummary,
    Lift,
    LiftOutcome,
    lift_columns,
    lift_of_table,
)
from rig.sessions.table_files import Columns, Line, csv_bytes

_OF_LIFT = {column.name: column for column in lift_columns()}
_OF_SESSION: Columns = {
    "session": str, "started": str, "bench": str, "simulated": bool, "estimator": str, "window": int,
}  # fmt: skip
_OF_REPLAY: Columns = {"identical": bool, "difference_deg": float, "problem": str}


_KINDS: Columns = {name: column.kind for name, column in _OF_LIFT.items()}
_BEFORE = list(_KINDS)[: list(_KINDS).index("recording") + 1]
COLUMNS: Columns = {**_OF_SESSION, **{name: _KINDS[name] for name in _BEFORE}, **_OF_REPLAY, **_KINDS}
"""Columns of tables of many lifts in order, with their types: `session` is its folder, `identical` whether a
replay gave exactly the stored lift, for `difference_deg` see `Agreement`, `problem` why the lift, a part of
it, or its session cannot be read."""
ERRORS = ("re_b", "re", "re_held")
"""Errors of a lift: over phase B, over phases B and C, over both with refused frames held."""


class Agreement(NamedTuple):
    """Comparison of replayed lifts with the stored ones.

    identical: number of lifts that are equal bit for bit. difference_deg: largest difference of an angle or
    an error; None if one is missing in the replayed or in the stored lift only.
    """

    lifts: int
    identical: int
    difference_deg: float | None


class _LineCodec(Codec[Line]):
    """Reads the rows of tables of many lifts."""

    def parse(self, text: bytes) -> Line:
        return self.parse_values(super().parse(text))

    def parse_values(self, values: Line) -> Line:
        """Return the row of some values. Raises `ValueError` naming the invalid column."""
        for name, value in values.items():
            kind = COLUMNS.get(name)
            if kind is None:
                raise ValueError(f"'{name}' is a key that this version does not know")
            fits = isinstance(value, (int, float) if kind is float else kind)
            if value is not None and (not fits or isinstance(value, bool) != (kind is bool)):
                raise ValueError(f"'{name}' should be of type {kind.__name__}, found {quote(value)}")
            if isinstance(value, float) and not isfinite(value):
                raise ValueError(f"'{name}' should be finite, found {value}")
        if missing := [name for name in ("session", "accepted") if values.get(name) is None]:
            raise ValueError(f"'{missing[0]}' is missing")
        return {name: values.get(name) for name in COLUMNS}


REPLAYS: Codec[Line] = _LineCodec(dict[str, str | bool | int | float | None])


def session_cells(folder: str, manifest: TrialManifest, estimator: str, window: int) -> Line:
    """Return the cells of a lift's session and of its estimator. folder: of the session."""
    about = {"session": folder, "started": manifest.started, "bench": manifest.bench}
    return {**about, "estimator": estimator, "window": window}


def table_row(about: Line, lift: Lift, stored: Lift | None = None, problem: str | None = None) -> Line:
    """Return a lift as a row.

    about: see `session_cells`. stored: if its session's own estimator was used again. problem: see `COLUMNS`.
    """
    cells = {name: column.value(lift) for name, column in _OF_LIFT.items()}
    same = compare_lifts(lift, stored) if stored else {}
    return dict.fromkeys(COLUMNS) | about | cells | same | {"problem": problem}


def compare_lifts(lift: Lift, stored: Lift) -> Line:
    """Return the cells that compare a replayed lift with the stored one."""
    columns = [column for name, column in _OF_LIFT.items() if name.endswith("_deg")]
    here, there = (np.array([column.value(of) for column in columns], dtype=float) for of in (lift, stored))
    known = (np.isnan(here) == np.isnan(there)).all()
    most_deg = float(np.nanmax(np.abs(here - there), initial=0.0)) if known else None
    return {"identical": lift == stored, "difference_deg": most_deg}


def agreement(rows: Iterable[Line]) -> Agreement | None:
    """Return how the compared lifts of a table agree with the stored ones; None if none was compared."""
    cells = [(row["identical"], row["difference_deg"]) for row in rows if row["identical"] is not None]
    most = [deg for _, deg in cells if isinstance(deg, float)]
    most_deg = max(most, default=0.0) if len(most) == len(cells) else None
    return Agreement(len(cells), sum(bool(same) for same, _ in cells), most_deg) if cells else None


def unread_row(about: Line, lift: Lift, problem: str) -> Line:
    """Return the row of a lift whose recording cannot be read. problem: the reason."""
    named = {
        name: getattr(lift, name) for name in ("number", "attempt", "object", "name", "lift", "simulated")
    }
    return dict.fromkeys(COLUMNS) | about | named | {"accepted": False, "problem": problem}


def broken_row(session: str, problem: str) -> Line:
    found = {"session": session, "number": 0, "attempt": 0, "accepted": False, "problem": problem}
    return dict.fromkeys(COLUMNS) | found


def has_figures(row: Line) -> bool:
    """Return whether the row has figures, even if `problem` names a gap."""
    return not row["problem"] or row["outcome"] is not None


def lifts_csv(lifts: Sequence[Lift]) -> bytes:
    """Return the lifts of one session as CSV, with a row per attempt."""
    tables = {IN_CSV, IF_REACTING} if any(of.react is not ReactionKind.NONE for of in lifts) else {IN_CSV}
    columns = [column for column in _OF_LIFT.values() if column.tables in tables]
    rows = [{column.name: column.value(lift) for column in columns} for lift in lifts]
    return csv_bytes(
        {column.name: column.kind for column in columns},
        # this table has True and False, `csv_bytes` would write true and false
        [{**row, "accepted": str(row["accepted"])} for row in rows],
    )


def table_lift(row: Line) -> Lift:
    """Return the lift of a row, with the values that tables have. Raises `InputError` if one is missing."""
    empty = [key for key in ("object", "name", "lift", "outcome", "answered") if row[key] is None]
    where = f"session {row['session']}, lift {row['number']}"
    if empty:
        raise InputError(f"{where}: {', '.join(empty)} is empty in the table")
    plain = {of.name for of in fields(Lift)} & _OF_LIFT.keys() - {"reactions", "react", "outcome"}
    values = {name: value for name in plain if (value := row[name]) is not None}
    errors = {part: _error(row, part) for part in ERRORS}
    try:
        outcome = LiftOutcome(str(row["outcome"]))
    except ValueError as error:
        raise InputError(f"{where}: outcome {quote(row['outcome'])} is not known in the table") from error
    return lift_of_table(**{**values, **errors, "outcome": outcome})


def summarize_table(rows: Sequence[Line]) -> TrialSummary:
    """Summarize the lifts of a table. Raises `InputError` as `table_lift` does."""
    lifts = [table_lift(row) for row in rows]
    return summarize_lifts(lifts, sum(lift.bench_s for lift in lifts))


def by_reaction(rows: Sequence[Line]) -> dict[str, list[Line]]:
    """Return the rows by reaction to slip; those without reaction come first."""
    kinds = sorted({str(row["react"] or "none") for row in rows}, key=lambda kind: (kind != "none", kind))
    return {kind: [row for row in rows if (row["react"] or "none") == kind] for kind in kinds}


def results_json(rows: Sequence[Line]) -> dict[str, object]:
    """Return the figures of a table for JSON output.

    Lifts that react to slip turn less. If a table has lifts with and without reaction, the figures are those
    of lifts without reaction, and `by_reaction` has the figures of each reaction.
    """
    good = [row for row in rows if has_figures(row)]
    found = agreement(good)
    apart = {kind: summarize_table(own).as_json() for kind, own in by_reaction(good).items()}
    return {
        "simulated": any(row["simulated"] for row in good),
        "estimators": sorted({str(row["estimator"]) for row in good}),
        "sessions": len({row["session"] for row in good}),
        "broken": [{key: row[key] for key in ("session", "problem")} for row in rows if row["problem"]],
        "identical": found and found.identical,
        "difference_deg": found and found.difference_deg,
        **next(iter(apart.values()), summarize_table(()).as_json()),
        **({"by_reaction": apart} if len(apart) > 1 else {}),
    }


def _error(row: Line, part: str) -> ErrorSummary | None:
    mean, std, most, count = (row[f"{part}_{of.name}"] for of in fields(ErrorSummary))
    if None in (mean, std, most, count):
        return None
    return ErrorSummary(float(mean), float(std), float(most), int(count))  # type: ignore[arg-type]
