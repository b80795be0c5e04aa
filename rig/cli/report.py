"""`rig report`: write the report of a session as one HTML page."""

import os
from dataclasses import dataclass
from pathlib import Path

from rig.cli.common import print_result, say
from rig.cli.options import JsonOption
from rig.declared import argument, file_place, option
from rig.terminal.onlookers import report_written
from rig.terminal.screen import begin_phase, end_phase


def report_after(folder: Path, unwanted: bool) -> str | None:
    """Write the report at the end of a trial or recording; return its path, or None without a report.

    The results are already on disk, so an error here must not fail the run.
    """
    if unwanted:
        return None
    from rig.report.write import write_report

    _begin_writing()
    try:
        path = write_report([folder], jobs=os.cpu_count() or 1).path
    except Exception as error:  # any error: the run itself is complete
        say(f"note: no report ({type(error).__name__}: {error}); try again: rig report {folder}")
        return None
    say(f"report: {path}")
    report_written(Path(path))
    return str(path)


def _begin_writing() -> None:
    end_phase(wait=True)
    begin_phase("writing the report", ticking=False)  # workers are forks, which must not copy a thread


@dataclass(frozen=True, slots=True)
class ReportOptions:
    sources: list[Path] = argument(
        ..., "Session folder of a trial or recording; or CSV files of lifts, or a folder of such files."
    )
    out: Path | None = option(
        None, "HTML file to write. Default: report.html in the session or folder.", callback=file_place
    )
    beside: Path | None = option(
        None, "Second session of the same lifts to compare with: one with a reaction to slip, one without."
    )
    picture: Path | None = option(
        None, "Also write a .png of the top of the page, rendered by Chromium.", callback=file_place
    )
    figures: str | None = option(
        None,
        "Also write these figures for a paper, into the folder 'figures' beside the page: .pdf, .svg, .png, "
        "88.9 mm wide, the table as .tex and .csv, and captions.txt. all, or names separated by commas: RE, "
        "finals, sigma, time, angle, rate, grip, onset, surface, table, lift:1, lift:2 ...",
    )
    json: JsonOption = False


def report(options: ReportOptions) -> None:
    """Write the report of a session as one HTML page without external files.

    The page of a damaged or unfinished session shows all data that can be read, and lists the errors of the
    rest.

    A CSV file holds one lift. Its columns are the time in s (`t_s`), the estimated angle in degrees
    (`estimate_deg` or `pred_deg`), the ground truth in degrees (`truth_deg` or `aruco_gt_deg`), and
    optionally the standard deviation (`sigma_deg`). An empty or nan estimate is a refused frame. Lines that
    begin with # are comments.

    Examples:
      rig report sessions/2026-11-21T093000_trial
      rig report sessions/old_trial --out trial.html
      rig report with_reaction --beside without
      rig report old_lifts/ --out old_lifts.html
      rig report wrench.csv knife.csv --json
      rig report sessions/old_trial --picture trial.png
      rig report sessions/old_trial --figures RE,lift:3 --out paper/trial.html
    """
    from rig.report.write import picture_of, require_picture, write_report

    if options.picture is not None:
        require_picture(options.picture)
    _begin_writing()
    written = write_report(options.sources, options.out, options.beside, options.figures, os.cpu_count() or 1)
    if options.picture is not None:
        picture_of(written.path, options.picture)
    for problem in written.problems:
        say(f"note: {problem}")
    if written.figures is not None:
        say(f"figures: {written.figures}")
    answer = {"report": str(written.path), "problems": list(written.problems)}
    if written.figures is not None:
        answer["figures"] = str(written.figures)
    print_result(options.json, answer, written.path)
