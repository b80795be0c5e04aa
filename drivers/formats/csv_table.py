"""CSV (RFC 4180) with a header: columns by name, rows with their line number, fields as text."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import FormatError
from drivers.formats.text import read_text, reason

MOST_BYTES = 64_000_000
"""Size limit of a CSV file."""
MOST_ROWS, MOST_FIELDS = 500_000, 3_000_000
"""Limits of a CSV file; 500,000 rows are two hours of frames at 60 Hz."""


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
        """Yield (line, fields by column); a missing field is "", fields beyond the header are ignored."""
        blank = dict.fromkeys(self.columns, "")
        for line, fields in self.lines:
            yield line, {**blank, **dict(zip(self.columns, fields, strict=False))}


def read_csv(path: Path, needed: Sequence[str] = (), delimiters: str = ",") -> CsvTable:
    """Read a table from a file, see `parse_csv`. Raises `FormatError` naming it."""
    table = parse_csv(read_text(path, MOST_BYTES), str(path), delimiters)
    table.require(*needed)
    return table


def read_csv_rows(path: Path, needed: Sequence[str] = ()) -> list[tuple[int, dict[str, str]]]:
    """Return (line, fields by column) of each row. Raises `FormatError`, also for a missing column."""
    return list(read_csv(path, needed).rows())


def parse_csv(text: str, where: str, delimiters: str = ",") -> CsvTable:
    """Parse a CSV text. Empty lines and lines that begin with # are skipped.

    where: name of the text in errors. delimiters: characters that may separate fields; the most frequent one
    in the header is used. Raises `FormatError`, also for a field or table that is too long; a table without
    rows is accepted.
    """
    rows: list[tuple[int, tuple[str, ...]]] = []
    fields = 0
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=_delimiter(text, delimiters))
        for row in reader:
            fields += len(row)
            if len(rows) > MOST_ROWS or fields > MOST_FIELDS:
                raise csv.Error(f"more than {MOST_ROWS} rows, or {MOST_FIELDS} fields")
            if any(row) and not row[0].startswith("#"):
                rows.append((reader.line_num, tuple(row)))
    except csv.Error as error:
        raise FormatError(f"{where}: is not valid CSV ({reason(error)})") from error
    header = rows[0][1] if rows else ()
    return CsvTable(where, tuple(name.strip() for name in header), tuple(rows[1:]))


def _delimiter(text: str, delimiters: str) -> str:
    head = next((line for line in text.split("\n", 50) if line.strip() and line[0] != "#"), "")
    return max(delimiters, key=head.count)
