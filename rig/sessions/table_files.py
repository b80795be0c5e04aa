"""Tables as CSV and Parquet."""

import csv
import io
from collections.abc import Iterable, Mapping
from typing import Any

from drivers.errors import InputError

Columns = Mapping[str, type]
"""Column names in order, each with `str`, `int`, `float` or `bool`; every value may be missing."""
UNITS = {
    "_deg": "deg", "_rad": "rad", "_s": "s", "_ms": "ms", "_px": "px", "_nm": "N m", "_n": "N", "_m": "m",
    "_counts": "counts",
}  # fmt: skip
"""Unit by the suffix of a column's name."""
Line = dict[str, object]


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


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    return "" if value is None else value
