"""CSV (RFC 4180) with a header: columns by name, rows with their line number, fields as text or numbers.

Fields are separated by commas, semicolons or tabs, the most frequent one in the header. Empty lines and lines
that begin with # are skipped. The last of the comments before a table without a header is its header if it
has as many fields, because `numpy.savetxt` writes it so.

One grammar of numbers holds for every table that the rig reads: a sign, digits with a decimal point, and a
decimal exponent; sign, point and exponent may be missing: `20`, `-.5`, `2.000e+01`. Python, NumPy, pandas,
MATLAB and spreadsheets write this form. Decimal commas are rejected with the cure, because `1,234` has two
meanings. Infinity, NaN, control characters, hexadecimal numbers and digits of other scripts are rejected.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TypeVar

from drivers.errors import FormatError
from drivers.formats.text import read_text, reason, shown

MAX_TIME_S = 9e9
"""Largest time, s. Larger times do not fit the 64-bit integer nanoseconds of files."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?[0-9.]*(?:,[0-9]+)+\.?[0-9]*(?:[eE][+-]?[0-9]+)?")
_BLANKS = " \t\r\n\f\v\u00a0"
_NS = 10**9
_MAX_WHOLE = 2**63
Value = TypeVar("Value", int, float)


def parse_number(text: str) -> float:
    """Parse a finite number, to the same value as Python's `float`.

    Raises `FormatError` that begins with the text; callers prefix its place.
    """
    text = text.strip(_BLANKS)
    if _COMMA.fullmatch(text):
        raise FormatError(
            f"{shown(text)} has a comma: write numbers with a decimal point, without thousands separators"
        )
    if not _NUMBER.fullmatch(text):
        raise FormatError(f"{shown(text)} is not a number")
    value = float(text)
    if not math.isfinite(value):
        raise FormatError(f"{shown(text)} is too large")
    return value


def parse_whole(text: str) -> int:
    """Parse an integer of 64 bits, also if it is written with a point or an exponent, as `2.0e+01`.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    exact = _exact(text, value) if abs(value) <= _MAX_WHOLE else None
    if exact is None or not -_MAX_WHOLE <= exact < _MAX_WHOLE:
        raise FormatError(f"{shown(text)} does not fit 64 bits")
    if exact != exact.to_integral_value():
        raise FormatError(f"{shown(text)} is not a whole number")
    return int(exact)


def parse_time_ns(text: str) -> int:
    """Parse a time in s, of at most `MAX_TIME_S`, and return it in ns without the rounding of a float.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    if abs(value) > MAX_TIME_S:
        raise FormatError(f"{shown(text)} is beyond {MAX_TIME_S:g} s: give times in s")
    return round(_exact(text, value) * _NS)


def number_in(row: Mapping[str, str], column: str, where: str) -> float:
    """Return the number in a column of a row. Raises `FormatError` naming place and column."""
    return _in(parse_number, row, column, where)


def whole_in(row: Mapping[str, str], column: str, where: str) -> int:
    """Return the integer in a column of a row. Raises `FormatError` naming place and column."""
    return _in(parse_whole, row, column, where)


def time_ns_in(row: Mapping[str, str], column: str, where: str) -> int:
    """Return the time in a column of a row: s in the table, ns here. Raises `FormatError` as the others."""
    return _in(parse_time_ns, row, column, where)


def _in(parse: Callable[[str], Value], row: Mapping[str, str], column: str, where: str) -> Value:
    try:
        return parse(row.get(column, ""))
    except FormatError as error:
        raise FormatError(f"{where}: column {column}: {error}") from error


def _exact(text: str, value: float) -> Decimal:
    """Return the exact value; 0 if it is below every float, since the exponents of decimals are limited."""
    return Decimal(text) if value else Decimal(0)


MOST_BYTES = 64_000_000
"""Size limit of a CSV file."""
MOST_ROWS, MOST_FIELDS = 500_000, 3_000_000
"""Limits of a CSV file; 500,000 rows are two hours of frames at 60 Hz."""
DELIMITERS = ",;\t"
Lines = list[tuple[int, tuple[str, ...]]]


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A table. columns: names in the header. lines: (last line number in the file, fields) of each row."""

    where: str
    columns: tuple[str, ...]
    lines: tuple[tuple[int, tuple[str, ...]], ...]

    def require(self, *needed: str) -> None:
        """Raise `FormatError` naming the columns that are missing."""
        missing = [name for name in needed if name not in self.columns]
        if missing:
            have = ", ".join(self.columns)[:80] or "nothing"
            raise FormatError(
                f"{self.where}: line 1 has no column {', '.join(missing)}: it needs {', '.join(needed)} and "
                f"has {have}"
            )

    def rows(self) -> Iterator[tuple[int, dict[str, str]]]:
        """Yield (line, fields by column); a missing field is ""."""
        blank = dict.fromkeys(self.columns, "")
        for line, fields in self.lines:
            yield line, {**blank, **dict(zip(self.columns, fields, strict=False))}


def read_csv(path: Path, needed: Sequence[str] = ()) -> CsvTable:
    """Read a table from a file, see `parse_csv`. Raises `FormatError` naming it."""
    table = parse_csv(read_text(path, MOST_BYTES), str(path))
    table.require(*needed)
    return table


def read_csv_rows(path: Path, needed: Sequence[str] = ()) -> list[tuple[int, dict[str, str]]]:
    """Return (line, fields by column) of each row. Raises `FormatError`, also for a missing column."""
    return list(read_csv(path, needed).rows())


def parse_csv(text: str, where: str) -> CsvTable:
    """Parse a CSV text. where: its name in errors.

    Raises `FormatError` for a field or table that is too long, and for a row with more fields than the
    header: decimal commas and unquoted commas in a text look so. A table without rows is accepted.
    """
    header, lines = _with_header(*_lines(text, where))
    for number, fields in lines:
        if any(fields[len(header) :]):
            raise FormatError(
                f"{where}: line {number} has {len(fields)} fields, the header {len(header)}: write numbers "
                "with a decimal point, and put a text that contains the separator in quotes"
            )
    return CsvTable(where, header, tuple(lines))


def _lines(text: str, where: str) -> tuple[tuple[str, ...], Lines]:
    """Return the last comment before the rows, and the rows, each with its last line number."""
    comment: tuple[str, ...] = ()
    lines: Lines = []
    fields = 0
    try:
        stream = io.StringIO(text, newline="")
        head = next((line for line in text.split("\n", 50) if line.strip() and line[0] != "#"), "")
        reader = csv.reader(stream, delimiter=max(DELIMITERS, key=head.count), skipinitialspace=True)
        for raw in reader:
            fields += len(raw)
            if len(lines) > MOST_ROWS or fields > MOST_FIELDS:
                raise csv.Error(f"more than {MOST_ROWS} rows, or {MOST_FIELDS} fields")
            row = tuple(field.strip() for field in raw)
            if row and row[0].startswith("#"):
                comment = comment if lines else (row[0].lstrip("# "), *row[1:])
            elif any(row):
                lines.append((reader.line_num, row))
    except csv.Error as error:
        raise FormatError(f"{where}: is not valid CSV ({reason(error)})") from error
    return comment, lines


def _with_header(comment: tuple[str, ...], lines: Lines) -> tuple[tuple[str, ...], Lines]:
    """Return the header and the rows below it: the first row, or the comment before a table of numbers."""
    if not lines:
        return (), []
    first = lines[0][1]
    if len(comment) == len(first):
        with suppress(FormatError):
            for field in first:
                parse_number(field)
            return comment, lines
    return first, lines[1:]
