"""Parts of pages: notices, charts and tables."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from rig.pages.figure import svg
from rig.pages.plot_data import Spot, plot_data


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

    alt: for screen readers, default the title. anchor: its id in the page, "" without one. explored: data of
    a lift that the page's program plots, see `rig.report.explored`. spots: values that the page's program
    shows near the pointer; without any the figure stays static.
    """

    title: str
    figure: Figure
    caption: str
    alt: str = ""
    anchor: str = ""
    explored: Mapping[str, Any] | None = None
    spots: Sequence[Spot] = ()

    @property
    def plot(self) -> dict[str, Any]:
        """The figure as data for the page's program."""
        return plot_data(self.figure, self.spots)

    @property
    def svg(self) -> Markup:
        """The figure as inline SVG."""
        return svg(self.figure, self.alt or self.title)


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


@dataclass(frozen=True, slots=True)
class ReportPage:
    """A page, and its figures and main table for a paper. simulated: whether the lifts are."""

    html: str
    charts: Sequence[Chart] = ()
    table: Table | None = None
    simulated: bool = False


def joined(items: Sequence[str], most: int = 4) -> str:
    """Return items as an enumeration, of many only the first `most`."""
    shown = list(items[:most])
    if len(items) > most:
        shown.append(f"{len(items) - most} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + f" and {shown[-1]}" if shown else ""


def linked(text: str, anchors: Mapping[str, str]) -> Markup:
    """Return a text as HTML, with each name of a lift in it as a link. anchors: ids in the page, by name."""
    if not anchors:
        return escape(text)
    names = "|".join(map(re.escape, sorted(anchors, key=len, reverse=True)))
    link = Markup('<a href="#{}">{}</a>')
    parts = re.split(rf"({names})(?!\d)", text)
    return Markup("").join(link.format(anchors[part], part) if part in anchors else part for part in parts)
