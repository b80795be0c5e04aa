"""The page of the sessions in a folder: a searchable table, errors over time, links to the reports."""

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

from rig.pages.figure import Spot, drawing
from rig.pages.page import render
from rig.pages.palette import ESTIMATE
from rig.report.parts import Chart, Table, made_text
from rig.report.write import REPORT, write_page
from rig.results.listing import SessionEntry
from rig.results.metrics import INTERVAL, Mare, mare_text

CHOSEN = ("kind", "bench", "objects", "estimator", "tags", "operator", "reaction", "limits", "state")
"""Columns in which the reader can choose a value."""

_LEAST_DAYS = 5.0 / 1440.0
"""Smallest margin of the time axis, in matplotlib's unit: of one session it would show years."""


def write_sessions(
    page: Path, folder: Path, entries: Sequence[SessionEntry], columns: Mapping[str, Sequence[str]]
) -> None:
    """Write the page of some sessions.

    columns: texts of the listing by heading, one per entry; the first column has the sessions' names. Raises
    `InputError` for an unwritable path, `RecordingError` if writing fails.
    """
    names = [_link(text, entry.folder, page) for text, entry in zip(columns["session"], entries, strict=True)]
    rows = [list(row) for row in zip(names, *list(columns.values())[1:], strict=True)]
    text = [number for number, name in enumerate(columns) if name not in ("done", "refused", "MB", "MARE")]
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
            if chart := _error_chart(sorted(known, key=lambda point: point[0]), title):
                charts.append(chart)
    table = Table(list(columns), rows, text, filters=chosen)
    benches = [entry.bench_manifest for entry in entries if entry.bench_manifest]
    values = {
        "folder": str(folder.resolve()),
        "simulated": bool(benches) and all(bench.simulated for bench in benches),
        "table": table,
        "charts": charts,
        "made": made_text(),
    }
    write_page(page, render("rig.report", "sessions.html", **values))


def _error_chart(known: Sequence[tuple[datetime, str, Mare]], title: str) -> Chart | None:
    """MARE of sessions over their dates, with its interval. known: start, name and MARE of each session."""
    if not known:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for when, _, mare in known:
            if mare.ends_deg is not None:
                axes.plot([date2num(when)] * 2, mare.ends_deg, color=ESTIMATE.light, linewidth=1)
        dates, means = [float(date2num(when)) for when, *_ in known], [mare.mean_deg for *_, mare in known]
        axes.plot(dates, means, "o", markersize=4, color=ESTIMATE.light)
        locator = AutoDateLocator(minticks=3, maxticks=6)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        margin = max(0.05 * (max(dates) - min(dates)), _LEAST_DAYS)
        axes.set_xlim(min(dates) - margin, max(dates) + margin)
        axes.set_ylim(0.0, 1.15 * axes.dataLim.ymax or 1.0)
        axes.set_xlabel("start of the session, UTC", loc="left")
        axes.set_ylabel("MARE in B and C, degrees")
        caption = f"Mean over the lifts of a session, with the {INTERVAL}."
        texts = [f"{name}, {when:%Y-%m-%d %H:%M} UTC: MARE {mare_text(mare)}°" for when, name, mare in known]
        spots = [Spot(float(x), y, text) for x, y, text in zip(dates, means, texts, strict=True)]
        return Chart(title, figure, caption, spots=spots)


def _began(entry: SessionEntry) -> datetime | None:
    try:
        return datetime.fromisoformat(entry.started).astimezone(UTC)
    except ValueError:
        return None


def _link(text: str, folder: Path, page: Path) -> str:
    """Return the name of a session with its folder, as a link to its report if it has one."""
    report = folder / REPORT
    named = Markup('<span data-session="{}">{}</span>').format(str(folder), text)
    if not report.is_file():
        return named
    place = Path(os.path.relpath(report, page.parent)).as_posix()
    return Markup('<a href="{}">{}</a>').format(quote(os.fsencode(place)), named)
