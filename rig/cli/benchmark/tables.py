"""The option that puts a table into a document, and the warning about failures of estimators."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import say
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rig.tactile.foreign import EstimatorFaults

ReadmeOption = Annotated[
    Path | None,
    typer.Option(
        "--readme",
        help="Put the table between its markers in this file, as docs/estimators.md.",
        callback=file_place,
    ),
]


def say_faults(faults: "Mapping[str, EstimatorFaults]") -> None:
    """Print the failures of estimators that are not the rig's own, by name."""
    for name, of in faults.items():
        say(f"warning: '{name}': {of}")
