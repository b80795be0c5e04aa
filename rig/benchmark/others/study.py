"""`rig benchmark others`: foreign clients and file readers on the rig's wire protocols and files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import RigError, unknown_name
from rig.benchmark.harness import Report, Run, Study, Table, option, table_of
from rig.benchmark.measured import at_most
from rig.benchmark.others.clients import Row, run_clients
from rig.benchmark.others.files import run_files


@dataclass(frozen=True, slots=True)
class OthersOptions:
    """Options of `rig benchmark others`: where clients and readers find their input."""

    part: list[str] | None = option(None, "clients or files; repeat. Default: both.")
    clones: Path | None = option(None, "Folder with clones of public repositories, as OWNER/NAME.")
    session: Path | None = option(None, "A session of rig trial, whose files are opened.")


PARTS: dict[str, Callable[[OthersOptions, Run], list[Row]]] = {
    "clients": lambda options, run: run_clients(options.clones, run),
    "files": lambda options, run: run_files(options.session, run),
}


def measure(options: OthersOptions, run: Run) -> Report:
    """Run third-party clients on the simulated devices, and third-party readers on session files.

    Each client and reader is a package or clone that is not part of the rig. If it is missing, its row is
    skipped and shows how to install it. All connections are on loopback. See docs/others.md. The exit code is
    4 if a result is not as expected.

    Examples:
      rig benchmark others --part clients

      rig benchmark others --clones clones/ --session my_session --json

    """
    rows: list[Row] = []
    for part in options.part or PARTS:
        if part not in PARTS:
            raise unknown_name("part", part, PARTS)
    for part in options.part or PARTS:
        try:
            rows += PARTS[part](options, run)
        except RigError as error:
            rows.append(Row(part, "the part itself", "", str(error), met=False))
    table = others_table(rows)
    wrong = [row for row in rows if row.met is False]
    return Report(
        tables=(table,),
        limits=(at_most("results that are not as expected", len(wrong), 0),),
        limits_of="foreign clients and readers",
        notes=[f"not as expected: {row.part}, {row.what}: {row.result}" for row in wrong],
        section=table.markdown(),
    )


def others_table(rows: Sequence[Row]) -> Table:
    """Return the table with a row for each client and reader."""
    return table_of("Foreign clients and file readers", Row, rows, left=5)


STUDY = Study(
    name="others",
    options=OthersOptions,
    measure=measure,
    cases="parts",
    shared=("readme",),
    simulated=False,
)
