"""Write the report of a trial, a recording or CSV tables, even if parts are damaged."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from drivers.errors import InputError
from rig.pages.page import render
from rig.report.parts import Notice, ReportPage, Table
from rig.report.session import UNREADABLE
from rig.report.text import made_text
from rig.sessions.files import write_file
from rig.sessions.manifest import RecordManifest, TrialManifest, is_session, read_manifest_of

REPORT = "report.html"
WITH_REPORT = (TrialManifest, RecordManifest)


@dataclass(frozen=True, slots=True)
class Written:
    """The file of a report, and messages about unreadable parts of its source."""

    path: Path
    problems: tuple[str, ...] = ()


def write_report(
    sources: Sequence[Path], out: Path | None = None, beside: Path | None = None, figures: Path | None = None
) -> Written:
    """Write the report of one session, or of CSV files (or folders of them) with two angle curves.

    out: the page's file; default `report.html` in the session or folder, in the current folder
    for single files. beside: another session of the same lifts, where one reacts to slip and one does not.
    figures: folder for the figures and the table of a trial, or of CSV files, as files for a paper.
    Raises `InputError` for sources that are neither, `RecordingError` if the page cannot be written.
    """
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: no such session, folder or file")
    session = next((s for s in sources if is_session(s)), None)
    if session is not None:
        if len(sources) > 1:
            raise InputError(f"{session} is a session: a report shows one session; rig compare compares two")
        page, problems = _session_page(session) if beside is None else _pair_page(session, beside)
        return _written(out or session / REPORT, page, problems, figures)
    if beside is not None:
        raise InputError(f"--beside {beside}: only a trial can be shown beside another")
    from rig.report.csv_lifts import read_tables
    from rig.report.curves_page import curves_page

    found = read_tables(sources)
    default = sources[0] / REPORT if len(sources) == 1 and sources[0].is_dir() else Path(REPORT)
    return _written(out or default, curves_page(found), found.notes, figures)


def _session_page(folder: Path) -> tuple[ReportPage, tuple[str, ...]]:
    try:
        manifest = read_manifest_of(folder, WITH_REPORT, "trials and recordings have reports")
        if isinstance(manifest, TrialManifest):
            from rig.report.session import read_trial
            from rig.report.trial_page import trial_page

            trial = read_trial(folder, manifest)
            return trial_page(trial), tuple(notice.what for notice in trial.problems)
        from rig.report.recording import read_recording
        from rig.report.recording_page import recording_page

        recording = read_recording(folder, manifest)
        return ReportPage(recording_page(recording)), tuple(notice.what for notice in recording.problems)
    except UNREADABLE as error:
        return ReportPage(_broken_page(folder, error)), (str(error),)


def _pair_page(folder: Path, beside: Path) -> tuple[ReportPage, tuple[str, ...]]:
    """Return the page of a trial beside another one. Raises `InputError`, `SessionError`."""
    from rig.report.session import read_trial
    from rig.report.trial_page import trial_page

    trial, other = (
        read_trial(each, read_manifest_of(each, TrialManifest, "only trials react to slip"))
        for each in (folder, beside)
    )
    page = trial_page(trial, other=other)
    return page, tuple(notice.what for each in (trial, other) for notice in each.problems)


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
        made=made_text(datetime.now(UTC)),
    )


def write_page(path: Path, html: str) -> None:
    """Write a page. Raises `InputError` for an unwritable path, `RecordingError` if writing fails."""
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the page a name with --out {path / REPORT}")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it, or choose another --out")
    write_file(path, html.encode("utf-8"))


def _written(path: Path, page: ReportPage, problems: Sequence[str], figures: Path | None) -> Written:
    if figures is not None and not page.charts:
        raise InputError(f"--figures {figures}: only readable trials and CSV files have figures")
    write_page(path, page.html)
    if figures is not None:
        from rig.report.paper_figures import write_paper

        write_paper(figures, page)
    return Written(path, tuple(problems))
