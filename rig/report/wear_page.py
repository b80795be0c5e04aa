"""The page of gel wear: noise, image change, contact area and error of sessions over days and weeks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

from drivers.errors import counted
from rig.pages.figure import drawing, legend_above
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, SERIES
from rig.pages.plot_data import Spot
from rig.report.parts import Chart, Notice, Table, joined
from rig.report.text import made_text
from rig.report.wear import SessionWear, TipWear
from rig.report.write import write_page
from rig.results.metrics import INTERVAL, Mare, mare_text
from rig.sessions.manifest import TrialManifest

MARKERS = ("o", "s", "^", "D")
_TIME = "%Y-%m-%d %H:%M"


@dataclass(frozen=True, slots=True)
class Dated:
    """A value of a session over the time of its start."""

    began: datetime
    session: str
    value: float

    def spot(self, text: str) -> Spot:
        """Return where the value is drawn. text: shown there after the session."""
        return Spot(
            float(date2num(self.began)), self.value, f"{self.session}, {self.began:{_TIME}} UTC: {text}"
        )


Points = list[Dated]


def write_wear(sessions: Sequence[SessionWear], problems: Sequence[str], page: Path) -> None:
    """Write the page of some sessions. Raises `InputError`, `RecordingError` if it cannot be written."""
    write_page(page, wear_page(sessions, problems))


def wear_page(sessions: Sequence[SessionWear], problems: Sequence[str], now: datetime | None = None) -> str:
    """Return the page of sessions, in the order in which they were begun."""
    days, serials = (sessions[-1].began - sessions[0].began).days, joined(_serials(sessions))
    errors = error_chart([(one.began, one.folder.name, one.mare) for one in sessions if one.mare])
    return render(
        "rig.report",
        "wear.html",
        simulated=any(session.manifest.simulated for session in sessions),
        about=f"{counted(len(sessions), 'session')} over {counted(days, 'day')}, sensors {serials}",
        warnings=_notices(sessions, problems),
        charts=[*wear_charts(sessions), *([errors] if errors else [])],
        table=_table(sessions),
        made=made_text(now or datetime.now(UTC)),
    )


def _notices(sessions: Sequence[SessionWear], problems: Sequence[str]) -> list[Notice]:
    found = [Notice("warn", "A session was left out.", problem) for problem in problems]
    kinds = {session.manifest.simulated for session in sessions}
    if len(kinds) > 1:
        advice = "They cannot be compared: select sessions with --tag or by their folder."
        found.append(Notice("bad", "The page contains both simulated and real sessions.", advice))
    methods = sorted({s.manifest.estimator for s in sessions if isinstance(s.manifest, TrialManifest)})
    if len(methods) > 1:
        what = f"The errors are those of several estimators: {joined(methods)}."
        found.append(Notice("warn", what, "Replay the sessions with the same estimator to compare them."))
    return found


def _serials(sessions: Sequence[SessionWear]) -> list[str]:
    return sorted({serial for session in sessions for serial in session.tips})


def wear_charts(sessions: Sequence[SessionWear], bench: str = "") -> list[Chart]:
    """Noise, change and contact of each sensor over the dates of sessions. bench: ends the titles."""

    def by_serial(value: Callable[[TipWear], float | None]) -> dict[str, Points]:
        found: dict[str, Points] = {serial: [] for serial in _serials(sessions)}
        for session in sessions:
            for serial, tip in session.tips.items():
                if (number := value(tip)) is not None:
                    found[serial].append(Dated(session.began, session.folder.name, number))
        return {serial: points for serial, points in found.items() if points}

    charts = [
        _chart(
            by_serial(lambda tip: tip.noise), f"Noise at rest{bench}", "noise, grey levels",
            "Standard deviation of the pixels of the untouched gel in the 0.25 s before a grasp.",
        ),
        _chart(
            by_serial(lambda tip: tip.change), f"Change of the gel at rest{bench}", "change, grey levels",
            "Difference of the untouched gel's image from that in the sensor's first session on this page.",
        ),
        _chart(
            by_serial(lambda tip: tip.contact_px), f"Contact{bench}", "contact area, px",
            "Median area of the contacts of a session. It also depends on objects and grips.",
        ),
    ]  # fmt: skip
    return [chart for chart in charts if chart is not None]


def _chart(series: dict[str, Points], title: str, unit: str, caption: str) -> Chart | None:
    if not series:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for number, (serial, points) in enumerate(series.items()):
            colour, marker = SERIES[number % len(SERIES)], MARKERS[number % len(MARKERS)]
            dates, values = [date2num(one.began) for one in points], [one.value for one in points]
            axes.plot(dates, values, marker=marker, markersize=4, color=colour.light, label=serial)
        _dated(axes, unit)
        legend_above(axes, 2)
        spots = [one.spot(f"{serial}, {one.value:.4g}") for serial, own in series.items() for one in own]
        return Chart(title, figure, caption, spots=spots)


def error_chart(known: Sequence[tuple[datetime, str, Mare]], title: str = "Error") -> Chart | None:
    """MARE of sessions over their dates, with its interval; None without sessions.

    known: start, name and MARE of each session.
    """
    if not known:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for when, _, mare in known:
            if mare.low_deg is not None and mare.high_deg is not None:
                axes.plot(
                    [date2num(when)] * 2, [mare.low_deg, mare.high_deg], color=ESTIMATE.light, linewidth=1
                )
        axes.plot(
            [date2num(when) for when, *_ in known], [mare.mean_deg for *_, mare in known], "o", markersize=4,
            color=ESTIMATE.light,
        )  # fmt: skip
        _dated(axes, "MARE in B and C, degrees")
        caption = f"Mean over the lifts of a session, with the {INTERVAL}."
        spots = [
            Dated(when, name, mare.mean_deg).spot(f"MARE {mare_text(mare)}°") for when, name, mare in known
        ]
        return Chart(title, figure, caption, spots=spots)


def _dated(axes: Axes, unit: str) -> None:
    """Set a date scale, and a value scale from zero with a margin at the top."""
    locator = AutoDateLocator(minticks=3, maxticks=6)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    axes.set_ylim(0.0, 1.15 * axes.dataLim.ymax or 1.0)
    axes.set_xlabel("start of the session, UTC", loc="left")
    axes.set_ylabel(unit)


def _table(sessions: Sequence[SessionWear]) -> Table:
    columns = (
        "session",
        "begun, UTC",
        "tags",
        "sensor",
        "noise",
        "change",
        "contact, px",
        "lifts",
        "MARE in B and C, °",
    )
    rows = []
    for session in sessions:
        for number, (serial, tip) in enumerate(session.tips.items()):
            own = not number
            rows.append(
                [
                    session.folder.name if own else "",
                    session.began.strftime(_TIME) if own else "",
                    ", ".join(session.manifest.remarks.tags) if own else "",
                    serial,
                    *(("" if v is None else f"{v:.2f}") for v in (tip.noise, tip.change)),
                    "" if tip.contact_px is None else f"{tip.contact_px:.0f}",
                    str(session.lifts or "") if own else "",
                    mare_text(session.mare) if own and session.lifts else "",
                ]
            )
    return Table(columns, rows, text=(0, 1, 2, 3))
