"""`rig report`: a page that a person looks at and sends."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, emit_json, say


def report(
    sources: Annotated[
        list[Path],
        typer.Argument(
            help="Session folder of a trial or recording; or CSV files of lifts, or a folder of them."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="The page; default report.html in the session or folder.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Write a session's report: one HTML page that needs nothing else, and prints.

    A session that is damaged or unfinished gets a page that shows what can be read and says what
    cannot. CSV files hold one lift each: a column of times in s (`t_s`), the estimated angle
    (`estimate_deg` or `pred_deg`) and the reference's (`truth_deg` or `aruco_gt_deg`), in degrees;
    `sigma_deg` if known. Empty or nan is refused; comments begin with #.

    Examples:
      rig report sessions/2026-11-21T093000_trial

      rig report sessions/old_trial --out trial.html

      rig report old_lifts/ --out old_lifts.html

      rig report wrench.csv knife.csv --json

    """
    from rig.report.write import write_report

    written = write_report(sources, out)
    for problem in written.problems:
        say(f"note: {problem}")
    if json:
        emit_json({"report": str(written.path), "problems": list(written.problems)})
    else:
        print(written.path)
