"""Write the report of a trial, a recording or CSV tables, even if parts are damaged."""

import csv
import io
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import InputError, RecordingError, no_such, unknown_name
from drivers.progress import begin_work, steps
from drivers.realtime import compute_in_one_thread
from rig.pages.figure import column_files, legend_outside
from rig.pages.page import render
from rig.report.parts import Chart, Notice, ReportPage, Table, made_text
from rig.report.session import UNREADABLE, Trial, read_trial
from rig.results.metrics import INTERVAL
from rig.sessions.files import write_file
from rig.sessions.manifest import RecordManifest, TrialManifest, is_session, read_manifest_of
from rig.version import version_text

REPORT = "report.html"
WITH_REPORT = (TrialManifest, RecordManifest)


@dataclass(frozen=True, slots=True)
class Written:
    """The file of a report, and messages about unreadable parts of its source.

    figures: folder of the figures for a paper, None without them.
    """

    path: Path
    problems: tuple[str, ...] = ()
    figures: Path | None = None


def write_report(
    sources: Sequence[Path],
    out: Path | None = None,
    beside: Path | None = None,
    figures: str | None = None,
    jobs: int = 1,
) -> Written:
    """Write the report of one session, or of CSV files (or folders of them) with two angle curves.

    out: the page's file; default `report.html` in the session or folder, in the current folder
    for single files. beside: another session of the same lifts, where one reacts to slip and one does not.
    figures: names of figures that are also written as files for a paper, into the folder `figures` beside the
    page, see `named_figures`.
    jobs: processes that read and draw a trial's lifts.
    Raises `InputError` for sources that are neither, `RecordingError` if the page cannot be written.
    """
    for source in sources:
        if not source.exists():
            raise InputError(no_such(source, "session, folder or file"))
    if jobs > 1:  # forks cannot use the threads of OpenCV
        compute_in_one_thread()
    if figures is not None:  # figures cannot leave the process that draws them
        jobs = 1
    session = next((s for s in sources if is_session(s)), None)
    if session is not None:
        if len(sources) > 1:
            raise InputError(f"{session} is a session: a report shows one session; rig compare compares two")
        if beside is None:
            page, problems = _session_page(session, jobs)
        else:
            why = "only trials react to slip"
            both = [
                read_trial(of, read_manifest_of(of, TrialManifest, why), jobs) for of in (session, beside)
            ]
            page, problems = _trial_page(jobs, *both)
        return _write(out or session / REPORT, page, problems, figures, sources)
    if beside is not None:
        raise InputError(f"--beside {beside}: only a trial can be shown beside another")
    from rig.report.curves_page import curves_page, read_tables

    lifts, notes = read_tables(sources)
    default = sources[0] / REPORT if len(sources) == 1 and sources[0].is_dir() else Path(REPORT)
    return _write(out or default, curves_page(lifts, notes), notes, figures, sources)


def _session_page(folder: Path, jobs: int) -> tuple[ReportPage, tuple[str, ...]]:
    try:
        manifest = read_manifest_of(folder, WITH_REPORT, "trials and recordings have reports")
        if isinstance(manifest, TrialManifest):
            return _trial_page(jobs, read_trial(folder, manifest, jobs))
        from rig.report.recording_page import read_recording, recording_page

        recording = read_recording(folder, manifest)
        return ReportPage(recording_page(recording)), tuple(notice.what for notice in recording.problems)
    except UNREADABLE as error:
        return ReportPage(_broken_page(folder, error)), (str(error),)


def _trial_page(jobs: int, trial: Trial, *others: Trial) -> tuple[ReportPage, tuple[str, ...]]:
    """Return the page of a trial, beside another one if it is given. Raises `InputError`."""
    from rig.report.trial_page import trial_page

    page = trial_page(trial, next(iter(others), None), jobs=jobs)
    return page, tuple(notice.what for of in (trial, *others) for notice in of.problems)


def _broken_page(folder: Path, error: BaseException) -> str:
    """Return the page of an unreadable session: the error, and the files in its folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and not p.name.startswith("."))
    rows = [[str(p.relative_to(folder)), f"{p.stat().st_size / 1e6:.2f}"] for p in files[:60]]
    return render(
        "rig.report",
        "broken.html",
        folder=folder,
        notice=Notice("bad", "This session cannot be shown.", str(error)),
        files=Table(("file", "MB"), rows) if rows else None,
        more=max(len(files) - len(rows), 0),
        made=made_text(),
    )


def write_page(path: Path, html: str) -> None:
    """Write a page. Raises `InputError` for an unwritable path, `RecordingError` if writing fails."""
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the page a name with --out {path / REPORT}")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it, or choose another --out")
    write_file(path, html.encode("utf-8", "replace"))  # a folder's name need not be UTF-8


def _write(
    path: Path, page: ReportPage, problems: Sequence[str], figures: str | None, sources: Sequence[Path]
) -> Written:
    if figures is None:
        write_page(path, page.html)
        return Written(path, tuple(problems))
    if not page.charts:
        raise InputError(f"--figures {figures}: only readable trials and CSV files have figures")
    chosen, folder = named_figures(page, figures), path.parent / "figures"
    write_page(path, page.html)
    typed = ["rig", "report", *map(str, sources), "--figures", figures]
    write_paper(folder, page, chosen, shlex.join(typed))
    return Written(path, tuple(problems), folder)


TABLE, CAPTIONS = "rotational_error", "captions.txt"
ABOUT_ERRORS = (
    "\u00b1: mean over the lifts of each lift's standard deviation, not a standard error. "
    f"[low, high]: {INTERVAL}."
)
PAPER_BIBTEX = (
    "@article{castanoamoros2023, title={Measuring Object Rotation via Visuo-Tactile Segmentation of Grasping "
    "Region}, author={Casta{\\~n}o-Amor{\\'o}s, Julio and Gil, Pablo}, journal={IEEE Robotics and Automation "
    "Letters}, year={2023}, url={https://ieeexplore.ieee.org/document/10149493}}"
)
SIMULATED = "simulated_"
"""Prefix of file names if the lifts are simulated, so that they are not published as measured."""
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{",
    "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "°": r"$^\circ$",
}  # fmt: skip


NAMES = {
    "Rotational error per object": "RE",
    "Final angles": "finals",
    "Does sigma cover the error?": "sigma",
    "Error over time": "time",
    "Error against angle": "angle",
    "Error against rate": "rate",
    "Grip and outcome": "grip",
    "Onset latency": "onset",
    "Error by grasped surface": "surface",
    "Error per lift": "lifts",
}
"""Name of each figure of a page for `--figures`, by its title. The figures of lifts are lift:1, lift:2 ..."""
EVERY, TABLE_NAME = "all", "table"


def named_figures(page: ReportPage, names: str) -> dict[str, Chart | Table]:
    """Return figures and the table of a page by the stem of their files.

    names: separated by commas, such as "RE,lift:3,table"; "all" for all. Raises `InputError`.
    """
    mark = SIMULATED if page.simulated else ""
    known: dict[str, tuple[str, Chart | Table]] = {}
    for chart in page.charts:
        stem = mark + re.sub(r"[^\w]+", "_", chart.title.replace("|", "")).strip("_")
        known[chart.anchor.replace("-", ":") or NAMES[chart.title]] = stem, chart
    if page.table is not None:
        known[TABLE_NAME] = f"{mark}{TABLE}", page.table
    wanted = list(known) if names == EVERY else [name.strip() for name in names.split(",")]
    for name in wanted:
        if name not in known:
            listed = ", ".join([EVERY, *(each for each in known if ":" not in each), "lift:NUMBER"])
            raise unknown_name("figure", name, known, listed=listed)
    return dict(known[name] for name in wanted)


def write_paper(folder: Path, page: ReportPage, chosen: Mapping[str, Chart | Table], command: str) -> None:
    """Write figures and a table of a page, and `captions.txt` with their captions and their origin.

    chosen: from `named_figures`. command: that writes them.
    Raises `InputError` if the folder cannot be made, `RecordingError` if a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another --out") from error
    captions = []
    begin_work("writing the figures")
    for stem, of in steps(chosen.items()):
        if isinstance(of, Table):
            rows = [[getattr(cell, "striptags", cell.strip)() for cell in row] for row in of.rows]
            plain, text = replace(of, rows=rows), io.StringIO()
            files = {"tex": latex(plain, page.simulated).encode()}
            csv.writer(text, lineterminator="\n").writerows([of.columns, *rows])
            files["csv"], caption = text.getvalue().encode(), f"Table of the errors. {ABOUT_ERRORS}"
        elif of.figure is None:
            continue
        else:
            legend_outside(of.figure)
            files, caption = column_files(of.figure), of.caption
        for ending, data in files.items():
            write_file(folder / f"{stem}.{ending}", data)
        captions.append(f"{stem}: {caption}\n")
    made = f"Made by the slip rig {version_text()}: {command}\n"
    made += "SIMULATED: objects, sensors and light are computed.\n" * page.simulated
    write_file(folder / CAPTIONS, "\n".join([*captions, made, bibtex()]).encode())


def bibtex() -> str:
    """Return entries for this software and for the paper whose method it measures, a line each."""
    rig = "@misc{sliprig, title={The slip rig}, author={{The slip rig developers}}, note={"
    return f"{rig}{version_text()}}}}}\n{PAPER_BIBTEX}\n"


def latex(table: Table, simulated: bool) -> str:
    """Return a table as a LaTeX tabular, which needs no package; comments define its numbers."""
    columns = "".join("l" if number in table.text else "r" for number in range(len(table.columns)))
    lines = [_latex_row(table.columns), r"\hline", *map(_latex_row, table.rows)]
    if table.total:
        lines.insert(-1, r"\hline")
    about = ["% SIMULATED: objects, sensors and light are computed."] * simulated + [f"% {ABOUT_ERRORS}"]
    begin, end = rf"\begin{{tabular}}{{{columns}}}", r"\end{tabular}"
    return "\n".join([*about, begin, r"\hline", *lines, r"\hline", end]) + "\n"


def _latex_row(cells: Sequence[str]) -> str:
    texts = ("".join(_LATEX.get(character, character) for character in cell) for cell in cells)
    return " & ".join(texts) + r" \\"


BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE_PX = (1200, 1300)
ENDING = ".png"
_AT_MOST_S = 60.0


def require_picture(out: Path) -> str:
    """Return the browser's program. Raises `InputError` if none is installed, or for another ending."""
    if out.suffix.lower() != ENDING:
        raise InputError(f"{out}: a report's picture is a {ENDING}; choose another --picture")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise InputError("--picture needs a browser: install chromium, or take the picture in your own")
    return found


def picture_of(page: Path, out: Path) -> None:
    """Write a screenshot of `SIZE_PX` of a page. Raises `RecordingError` if the browser fails."""
    browser = require_picture(out)
    with TemporaryDirectory(prefix="rig-picture-") as folder:
        taken = Path(folder) / "page.png"
        flags = ["--headless", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}/profile"]
        as_root = ["--no-sandbox"] if os.geteuid() == 0 else []  # as root it does not start otherwise
        size = f"--window-size={SIZE_PX[0]},{SIZE_PX[1]}"
        command = [browser, *flags, *as_root, size, f"--screenshot={taken}", page.resolve().as_uri()]
        try:
            subprocess.run(command, capture_output=True, timeout=_AT_MOST_S, check=True)  # noqa: S603
            picture = taken.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            raise RecordingError(
                f"{page}: {browser} took no picture ({type(error).__name__}); take it in your own browser"
            ) from error
    write_file(out, picture)
