"""Parts of pages: notices, charts, tables, and texts that are the same on every page."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, TypeVar

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from rig.pages.figure import Spot, drawn_svg, plot_data, with_own_ids
from rig.pages.numbers import with_minus
from rig.results.metrics import Mare
from rig.sessions.manifest import BenchManifest, TrialManifest
from rig.sessions.records import Lift

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Notice:
    """A notice to the reader: an observation, and advice.

    level: "bad" (figures are missing or wrong), "warn" (figures are less reliable than they seem), "good".
    """

    level: str
    what: str
    advice: str


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure with its title and what it shows.

    figure: None if another process has drawn it. alt: for screen readers, default the title. anchor: its id
    in the page, "" without one. explored: data of a lift that the page's program plots, see
    `rig.report.explored`. spots: values that the page's program shows near the pointer; without any the
    figure stays static. drawn: the figure as `drawn_svg`, if that is done already.
    """

    title: str
    figure: Figure | None
    caption: str
    alt: str = ""
    anchor: str = ""
    explored: Mapping[str, Any] | None = None
    spots: Sequence[Spot] = ()
    drawn: str = ""

    @property
    def plot(self) -> dict[str, Any]:
        return {} if self.figure is None else plot_data(self.figure, self.spots)

    @property
    def svg(self) -> Markup:
        return with_own_ids(self.drawn or self.draw())

    def draw(self) -> str:
        """Return the figure as `drawn_svg`, "" without one."""
        return "" if self.figure is None else drawn_svg(self.figure, self.alt or self.title)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of ready text.

    text: columns that hold words. total: whether the last row sums up. filters: columns that the reader
    filters by where JavaScript runs, "choose" one of the values or give the "least" number; with one the
    columns also sort.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    text: Sequence[int] = (0,)
    total: bool = False
    filters: Mapping[int, str] = field(default_factory=dict)


def table_of(
    items: Iterable[Item],
    columns: Mapping[str, Callable[[Item], str]],
    total: Sequence[str] = (),
    text: Sequence[int] = (0,),
    filters: Mapping[int, str] | None = None,
) -> Table:
    """Return a table with a row per item. columns: an item's text for each heading. total: the last row."""
    rows = [[cell(item) for cell in columns.values()] for item in items]
    return Table(tuple(columns), [*rows, *([total] if total else [])], text, bool(total), filters or {})


@dataclass(frozen=True, slots=True)
class ReportPage:
    """A page, and its figures and main table for a paper. simulated: whether the lifts are."""

    html: str
    charts: Sequence[Chart] = ()
    table: Table | None = None
    simulated: bool = False


def anchor(lift: Lift) -> str:
    return f"lift-{lift.number}"


def join_items(items: Sequence[str], most: int = 4) -> str:
    """Return items as an enumeration, of many only the first `most`."""
    shown = list(items[:most])
    if len(items) > most:
        shown.append(f"{len(items) - most} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + f" and {shown[-1]}" if shown else ""


def link_lifts(text: str, anchors: Mapping[str, str]) -> Markup:
    """Return a text as HTML, with each name of a lift in it as a link. anchors: ids in the page, by name."""
    text = with_minus(text)
    if not anchors:
        return escape(text)
    names = "|".join(map(re.escape, sorted(anchors, key=len, reverse=True)))
    link = Markup('<a href="#{}">{}</a>')
    parts = re.split(rf"({names})(?!\d)", text)
    return Markup("").join(link.format(anchors[part], part) if part in anchors else part for part in parts)


def mare_tile(value: Mare | None, what: str) -> tuple[str, str]:
    """Return the tile of a MARE: the figure, and below it a description with interval and refused lifts."""
    figure = "no answer" if value is None else f"{value.mean_deg:.2f} ± {value.std_deg:.2f}°"
    return figure, f"{what} {value.beside if value else ''}".rstrip()


def made_text(when: datetime | None = None) -> str:
    """Return the creation time of a page. when: in UTC, default now."""
    return (when or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")


def angle_text(angle_deg: float | None) -> str:
    if angle_deg is None or not math.isfinite(angle_deg):
        return "refused"
    return with_minus(f"{angle_deg:+z.1f}°")


def header(manifest: BenchManifest, what: str) -> dict[str, str]:
    """Return the texts of the head: SIMULATED or not, bench, date, settings, and the session's metadata."""
    trial = manifest if isinstance(manifest, TrialManifest) else None
    parts = [
        manifest.started.replace("T", " ")[:16],
        f"estimator {trial.estimator}, window {trial.window}" if trial else "",
        f"seed {manifest.seed}" if manifest.simulated else "",
        f"rig {manifest.tool_version}",
    ]
    return {
        "mark": "SIMULATED" if manifest.simulated else "",
        "bench": f"bench '{manifest.bench}'",
        "what": f"{manifest.remarks.name}: {what}" if manifest.remarks.name else what,
        "remarks": " · ".join(manifest.remarks.lines()),
        "details": ", ".join(part for part in parts if part),
    }
