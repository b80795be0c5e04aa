"""Anyone's CSV files: their rows, each with the line at which it ends."""

import csv
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError


def read_csv_rows(path: Path, columns: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a CSV file with a header that has these columns at least, none for a header alone.

    Fields that a row lacks are empty; a byte order mark does no harm. Raises `InputError`.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, restval="")
            missing = [name for name in columns if name not in (reader.fieldnames or ())]
            if missing:
                raise InputError(f"{path}: line 1 has no column {', '.join(missing)}: add it")
            return [(reader.line_num, row) for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): give a CSV file") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is no CSV text ({error}): give columns {', '.join(columns)}") from error
