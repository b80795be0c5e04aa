"""The page of the sessions in a folder: a searchable table, errors over time, links to the reports."""

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from rig.pages.page import render
from rig.report.parts import Chart, Table
from rig.report.text import made_text
from rig.report.wear import SessionWear
from rig.report.wear_page import error_chart, wear_charts
from rig.report.write import REPORT, write_page
from rig.results.listing import SessionEntry

CHOSEN = ("kind", "bench", "objects", "tags", "operator", "reaction", "state")
"""Columns in which the reader can choose a value."""


def write_sessions(
    page: Path,
    folder: Path,
    entries: Sequence[SessionEntry],
    columns: Mapping[str, Sequence[str]],
    wear: Sequence[SessionWear] = (),
) -> None:
    """Write the page of some sessions.

    columns: texts of the listing by heading, one per entry; the first column has the sessions' names. wear:
    of the sessions whose sensors are shown over time. Raises `InputError` for an unwritable path,
    `RecordingError` if writing fails.
    """
    names = [_link(text, entry.folder, page) for text, entry in zip(columns["session"], entries, strict=True)]
    rows = [list(row) for row in zip(names, *list(columns.values())[1:], strict=True)]
    text = [number for number, name in enumerate(columns) if name not in ("done", "MB", "MARE")]
    chosen = {number: "choose" for number, name in enumerate(columns) if name in CHOSEN}
    charts = []
    for simulated, what in ((False, "real benches"), (True, "SIMULATED benches")):
        for react in sorted({entry.react for entry in entries}):
            known = [
                (began, entry.folder.name, entry.mare)
                for entry in entries
                if entry.mare and entry.bench_manifest and entry.bench_manifest.simulated == simulated
                if entry.react == react and (began := _began(entry)) is not None
            ]
            reacting = f", reaction to slip '{react}'" if react else ""
            title = f"Error on {what}{reacting}"
            if chart := error_chart(sorted(known, key=lambda point: point[0]), title):
                charts.append(chart)
        charts += wear_charts([own for own in wear if own.manifest.simulated == simulated], f", {what}")
    write_page(page, sessions_page(str(folder), Table(list(columns), rows, text, filters=chosen), charts))


def sessions_page(folder: str, table: Table, charts: Sequence[Chart]) -> str:
    """Return the page as HTML. charts: errors over time."""
    made = made_text(datetime.now(UTC))
    return render("rig.report", "sessions.html", folder=folder, table=table, charts=charts, made=made)


def _began(entry: SessionEntry) -> datetime | None:
    try:
        return datetime.fromisoformat(entry.started).astimezone(UTC)
    except ValueError:
        return None


def _link(text: str, folder: Path, page: Path) -> str:
    """Return the name of a session, as a link to its report if it has one."""
    report = folder / REPORT
    if not report.is_file():
        return text
    place = Path(os.path.relpath(report, page.parent)).as_posix()
    return Markup('<a href="{}">{}</a>').format(quote(place), text)
