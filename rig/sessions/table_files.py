"""Tables as CSV and Parquet; the columns of the tables of lifts, declared once."""

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivers import formats
from drivers.errors import InputError
from rig.sessions.codec import Codec, strict

Columns = Mapping[str, type]
"""Column names in order, each with `str`, `int`, `float` or `bool`; every value may be missing."""
UNITS = {
    "_deg": "deg", "_rad": "rad", "_s": "s", "_px": "px", "_nm": "N m", "_n": "N", "_m": "m",
    "_counts": "counts",
}  # fmt: skip
"""Unit by the suffix of a column's name."""
Line = dict[str, object]
IN_CSV = "always"
"""A column that is also in the `lifts.csv` of a session."""
IF_REACTING = "if a lift reacts to slip"
"""A column that is in `lifts.csv` only if a lift of the session reacts to slip."""


def csv_bytes(columns: Columns, lines: Iterable[Mapping[str, object]]) -> bytes:
    """Return a table as CSV; unknown values are empty, booleans are true and false."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(line.get(name)) for name in columns} for line in lines)
    return text.getvalue().encode()


def parquet_bytes(
    columns: Columns, lines: Iterable[Mapping[str, object]], about: Mapping[str, str] | None = None
) -> bytes:
    """Return a table as Parquet, with each column's unit, and `about` as the file's metadata.

    Raises `InputError` if pyarrow is not installed.
    """
    arrow, parquet = pyarrow_modules()
    kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    described = [
        arrow.field(name, kinds[kind], metadata={"unit": unit} if (unit := unit_of(name)) else None)
        for name, kind in columns.items()
    ]
    schema = arrow.schema(described, metadata=dict(about) if about else None)
    sink = io.BytesIO()
    parquet.write_table(arrow.Table.from_pylist(list(lines), schema=schema), sink)
    return sink.getvalue()


def unit_of(column: str) -> str | None:
    """Return the unit in a column's name; None for text, numbers and quaternions."""
    return next((unit for end, unit in UNITS.items() if column.endswith(end)), None)


def read_csv(path: Path, columns: Columns) -> list[Line]:
    """Read a CSV table; unknown columns are text. Raises `FormatError`, `ValueError`."""
    return [
        {name: _value(columns.get(name, str), text) for name, text in line.items()}
        for _, line in formats.read_csv(path).rows()
    ]


def read_parquet(path: Path) -> list[Line]:
    """Read a Parquet table. Raises `OSError`, `ValueError`, `InputError` as `parquet_bytes`."""
    return pyarrow_modules()[1].read_table(path).to_pylist()


def has_parquet() -> bool:
    """Whether Parquet can be written here."""
    return find_spec("pyarrow") is not None


def pyarrow_modules() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet module. Raises `InputError` with the command that installs them."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            'Parquet needs pyarrow: pip install "visuotactile-slip-rig[export]", or use CSV'
        ) from error
    return pyarrow, pyarrow.parquet


def _value(kind: type, text: str | None) -> object:
    if not text:
        return None
    return text == "true" if kind is bool else kind(text)


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    return "" if value is None else value


def lift_column(doc: str, in_csv: str = "never") -> Any:
    """Declare a column. doc: its meaning; its unit is in the suffix of its name. in_csv: see `IN_CSV`."""
    return field(default=None, metadata={"doc": doc, "in_csv": in_csv})


@strict
@dataclass(frozen=True, kw_only=True)
class ReplayRow:
    """One lift as a flat line: of `replays.jsonl`, `results.csv`, an exported table, and `lifts.csv`.

    Every column of a lift is declared here, once; see `lift_column`. A value is None if it is unknown.
    """

    session: str = field(metadata={"doc": "folder of the session"})
    started: str | None = lift_column("start of the session, UTC")
    bench: str | None = lift_column("name of the bench")
    simulated: bool | None = lift_column("whether the bench was simulated")
    estimator: str | None = lift_column("estimator of the angle")
    window: int | None = lift_column("number of angles in its moving mean")
    number: int | None = lift_column("number in the session, from 1; 0: session cannot be read", IN_CSV)
    attempt: int | None = lift_column("repetition of the lift, from 0", IN_CSV)
    object: str | None = lift_column("id of the object", IN_CSV)
    name: str | None = lift_column("name of the object", IN_CSV)
    lift: int | None = lift_column("number of the lift for its object, from 1", IN_CSV)
    position: str | None = lift_column("grasp position, as the object's file names it", IN_CSV)
    accepted: bool = field(metadata={"doc": "whether the lift counts", "in_csv": IN_CSV})
    outcome: str | None = lift_column("how the lift ended", IN_CSV)
    fault: str | None = lift_column("fault that ended the lift", IN_CSV)
    grip_counts: int | None = lift_column("grip beyond first contact, in steps of the gripper", IN_CSV)
    lift_height_m: float | None = lift_column("height of the lift", IN_CSV)
    final_estimate_deg: float | None = lift_column("mean estimate over the last 0.3 s of phase C", IN_CSV)
    final_truth_deg: float | None = lift_column("mean true angle over the last 0.3 s of phase C", IN_CSV)
    onset_truth_s: float | None = lift_column("true onset of slip, since the start of phase B", IN_CSV)
    onset_estimate_s: float | None = lift_column("onset found afterwards in the estimate", IN_CSV)
    onset_alarm_s: float | None = lift_column("onset reported during the lift")
    answered: float | None = lift_column("share of frames with an angle", IN_CSV)
    bench_s: float | None = lift_column("duration by the bench's clock", IN_CSV)
    recording: str | None = lift_column("recording in the session's folder", IN_CSV)
    identical: bool | None = lift_column("whether a replay gave exactly the stored row")
    problem: str | None = lift_column("why the lift, a part of it, or its session cannot be read")
    re_b_mean_deg: float | None = lift_column("mean absolute error over phase B", IN_CSV)
    re_b_std_deg: float | None = lift_column("standard deviation of the same", IN_CSV)
    re_b_max_deg: float | None = lift_column("maximum of the same", IN_CSV)
    re_b_frames: int | None = lift_column("number of frames of the same")
    re_mean_deg: float | None = lift_column("mean absolute error over phases B and C", IN_CSV)
    re_std_deg: float | None = lift_column("standard deviation of the same", IN_CSV)
    re_max_deg: float | None = lift_column("maximum of the same", IN_CSV)
    re_frames: int | None = lift_column("number of frames of the same")
    re_held_mean_deg: float | None = lift_column("mean absolute error with refused frames held", IN_CSV)
    re_held_std_deg: float | None = lift_column("standard deviation of the same", IN_CSV)
    re_held_max_deg: float | None = lift_column("maximum of the same", IN_CSV)
    re_held_frames: int | None = lift_column("number of frames of the same")
    react: str | None = lift_column("reaction to slip", IF_REACTING)
    reactions: int | None = lift_column("number of reactions", IF_REACTING)
    counts_added: int | None = lift_column("grip added by reactions", IF_REACTING)
    reaction_onset_s: float | None = lift_column("true onset before the first reaction", IF_REACTING)
    reaction_event_s: float | None = lift_column("capture of the frame that caused it", IF_REACTING)
    reaction_command_s: float | None = lift_column("command to stop the arm", IF_REACTING)
    reaction_standstill_s: float | None = lift_column("arm and fingers at standstill", IF_REACTING)
    warnings: str | None = lift_column("reasons to doubt the figures of the lift", IN_CSV)
    estimator_fault: str | None = lift_column("failures of an estimator of another package")
    speed_fraction: float | None = lift_column("position of the arm's speed slider, 0 to 1", IN_CSV)

    @property
    def measured(self) -> bool:
        """Whether the row has figures, even if `problem` names a gap."""
        return not self.problem or self.outcome is not None


REPLAYS: Codec[ReplayRow] = Codec(ReplayRow)
