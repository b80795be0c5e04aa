"""`rig benchmark others`: foreign clients and file readers on the rig's wire protocols and files."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.errors import RigError, unknown_name
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.harness import machine
from rig.benchmark.others.clients import run_clients
from rig.benchmark.others.files import run_files
from rig.benchmark.others.rows import Row, Say
from rig.benchmark.readme import markdown_table

COLUMNS = ("part", "what", "version", "result", "passed")


@dataclass(frozen=True, slots=True)
class Sources:
    """Where the foreign clients and readers find their input.

    clones: folder with clones of repositories, as OWNER/NAME. session: a session of `rig trial`.
    """

    clones: Path | None
    session: Path | None


PARTS: dict[str, Callable[[Sources, Say], list[Row]]] = {
    "clients": lambda sources, say: run_clients(sources.clones, say),
    "files": lambda sources, say: run_files(sources.session, say),
}


def run_others(parts: Sequence[str], sources: Sources, say: Say) -> list[Row]:
    """Run the named parts, all by default. Raises `InputError` for an unknown part."""
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise unknown_name("part", unknown[0], PARTS)
    rows: list[Row] = []
    for part in parts or PARTS:
        try:
            rows += PARTS[part](sources, say)
        except RigError as error:
            rows.append(Row(part, "the part itself", "", str(error), met=False))
    return rows


def others_table(rows: Sequence[Row]) -> BenchmarkTable:
    """Return the table with a row for each client and reader."""
    words = {True: "yes", False: "NO", None: ""}
    cells = [(row.part, row.what, row.version, row.result, words[row.met]) for row in rows]
    return BenchmarkTable("Foreign clients and file readers", COLUMNS, cells)


def others_section(rows: Sequence[Row]) -> str:
    """Return the table in Markdown, as in the docs."""
    table = others_table(rows)
    return markdown_table(table.columns, [[cell.replace("|", "/") for cell in row] for row in table.rows])


def as_json(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rows as JSON values, with the machine on which they were measured."""
    return {"schema": 1, "machine": machine(), "rows": [asdict(row) for row in rows]}
