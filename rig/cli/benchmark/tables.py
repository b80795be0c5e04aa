"""How benchmarks print their tables, and the option that puts one into a README."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import say
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rig.benchmark.estimators.tables import BenchmarkTable
    from rig.tactile.foreign import EstimatorFaults

ReadmeOption = Annotated[
    Path | None,
    typer.Option(
        "--readme",
        help="Put the table between its markers in this file, as docs/estimators.md.",
        callback=file_place,
    ),
]


def print_tables(tables: "Sequence[BenchmarkTable]", to_stderr: bool, wall_s: float, left: int = 2) -> None:
    """Print tables whose first columns stand on the left, and how long it all took. left: how many."""
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table

    console = table_console(to_stderr)
    for table in tables:
        console.print(console_table(table.columns, table.rows, left, table.title))
    console.print(f"{wall_s:.0f} s", highlight=False)


def say_faults(faults: "Mapping[str, EstimatorFaults]") -> None:
    """Say where estimators that are not the rig's own failed, by name."""
    for name, of in faults.items():
        say(f"warning: '{name}': {of}")
