"""`rig benchmark others`: everything that nobody here made, in one table."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.errors import RigError, unknown_name
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.harness import machine
from rig.benchmark.others.clients import run_clients
from rig.benchmark.others.files import run_files
from rig.benchmark.others.pose_sets import run_kinhec
from rig.benchmark.others.real_sets import run_boards, run_streams
from rig.benchmark.others.recordings import run_recordings
from rig.benchmark.others.robot_world import run_robot_world
from rig.benchmark.others.rows import Row, Say
from rig.benchmark.readme import markdown_table

COLUMNS = ("part", "what", "version", "result", "ours", "theirs", "as it should")


@dataclass(frozen=True, slots=True)
class Sources:
    """Where others' things are. clones: OWNER/NAME folders; session: one of `rig trial`; kinhec: its data."""

    clones: Path | None
    session: Path | None
    kinhec: Path


PARTS: dict[str, Callable[[Sources, Say], list[Row]]] = {
    "clients": lambda at, say: run_clients(at.clones, say),
    "kinhec": lambda at, say: run_kinhec(at.kinhec, say),
    "boards": lambda at, say: [*run_boards(at.clones, say), *run_robot_world(at.clones, say)],
    "streams": lambda at, say: run_streams(at.clones, say),
    "recordings": lambda at, say: run_recordings(at.clones, say),
    "files": lambda at, say: run_files(at.session, say),
}


def run_others(parts: Sequence[str], sources: Sources, say: Say) -> list[Row]:
    """Run the parts, all where none is named. Raises `InputError` for a part that is none."""
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
    """Return a row for each thing that was run or skipped."""
    said = {True: "yes", False: "NO", None: ""}
    cells = [(r.part, r.what, r.version, r.result, r.ours, r.theirs, said[r.met]) for r in rows]
    return BenchmarkTable("Others' clients, data and solvers", COLUMNS, cells)


def others_section(rows: Sequence[Row]) -> str:
    """Return the table in Markdown, as it stands in the docs."""
    table = others_table(rows)
    return markdown_table(table.columns, [[cell.replace("|", "/") for cell in row] for row in table.rows])


def as_json(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rows as JSON values, with what they were measured on."""
    return {"schema": 1, "machine": machine(), "rows": [asdict(row) for row in rows]}
