"""Read the tables that the rig writes."""

import csv
from pathlib import Path

from rig.sessions.table_files import Columns, Line


def read_typed_csv(path: Path, columns: Columns) -> list[Line]:
    """Return the rows of a CSV table with values of the columns' types, None for an empty cell."""

    def typed(kind: type, text: str) -> object:
        if not text:
            return None
        return text == "true" if kind is bool else kind(text)

    with path.open(newline="") as file:
        return [
            {name: typed(columns[name], text) for name, text in row.items()} for row in csv.DictReader(file)
        ]
