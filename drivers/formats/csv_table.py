"""CSV (RFC 4180) with a header: columns by name, rows with their line number, fields as trimmed text.

Fields are separated by commas, semicolons or tabs, the most frequent one in the header. Empty lines and lines
that begin with # are skipped. The last of the comments before a table without a header is its header if it
has as many fields, because `numpy.savetxt` writes it so.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import FormatError
from drivers.formats.numbers import parse_number
from drivers.formats.text import read_text, reason

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
