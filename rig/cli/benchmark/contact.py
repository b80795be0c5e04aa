"""`rig benchmark contact`: contact told from an empty gel, on recordings of which that is known."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.benchmark.tables import print_tables
from rig.cli.common import JsonOption, emit_json

if TYPE_CHECKING:
    from rig.benchmark.contact.benchmark import ContactResult


def contact(
    folder: Annotated[Path, typer.Argument(help="Folder with the recordings: videos or folders of images.")],
    spans: Annotated[
        Path | None,
        typer.Option(
            "--spans",
            help="CSV: clip,first,last,contact (yes or no),background,background_first,background_last; "
            "frames count from 0. Default: of the public clips of dotted gels.",
        ),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option("--estimator", help="Repeat for more; limits are for the first. Default: slip."),
    ] = None,
    empty: Annotated[
        float, typer.Option("--empty", help="Most frames of an empty gel told as contact, a share.")
    ] = 0.05,
    held: Annotated[
        float, typer.Option("--held", help="Least frames that hold something told as contact, a share.")
    ] = 0.95,
    json: JsonOption = False,
) -> None:
    """Count how often estimators say contact where a gel is empty, and where it holds something.

    Made for gels with printed dots, which are no contact. Every named frame counts, in the order of the
    recording; whatever is not no_contact is contact. Exit code 4 when a limit of the first
    estimator was missed.

    Examples:
      rig benchmark contact marker_slip_clips/

      rig benchmark contact marker_slip_clips/ --estimator slip --estimator kolamuri --json

    """
    from rig.benchmark.contact.benchmark import as_json, run_contact
    from rig.benchmark.contact.spans import read_spans
    from rig.cli.printing import WorkProgress
    from rig.tactile.estimators import choose_estimator

    choices = [choose_estimator(name) for name in estimator or ["slip"]]
    clips = read_spans(spans)
    with WorkProgress(0, "clips") as progress:
        result = run_contact(folder, clips, choices, empty, held, progress.show)
    _print(result, json)
    if json:
        emit_json(as_json(result))
    exit_where_missed(result.limits)


def _print(result: "ContactResult", to_stderr: bool) -> None:
    from rig.benchmark.contact.benchmark import contact_table
    from rig.benchmark.estimators.tables import limit_table

    name = next(iter(result.clips))
    tables = (contact_table(result), limit_table(result.limits, f"'{name}'"))
    print_tables(tables, to_stderr, result.wall_s)
