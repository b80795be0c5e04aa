"""Draw the chart of the benchmark: error over run time, and error over window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from drivers.errors import counted
from rig.benchmark.estimators.contenders import NO_SKIP, PAPER, WINDOWS
from rig.benchmark.estimators.tables import EstimatorsResult
from rig.pages.figure import drawing, png, svg
from rig.pages.palette import ESTIMATE, FIRST, INK, LINE, MUTED, TRUTH, WARNING
from rig.pages.palette import PAPER as SHEET
from rig.tactile.estimators import DEFAULT_ESTIMATOR, PUBLISHED

# The palette of Okabe and Ito, distinguishable with any colour vision; the shapes differ, too.
_LOOKS = {
    DEFAULT_ESTIMATOR: (ESTIMATE.light, "o"),
    NO_SKIP: (ESTIMATE.light, "o"),
    "ecc": (FIRST.light, "s"),
    "polar": ("#56B4E9", "D"),
    "skeleton": (TRUTH.light, "^"),
    "ellipse": (WARNING.light, "v"),
    "pca": ("#CC79A7", "P"),
}
_OTHERS = (INK.light, "X")
_LABEL_GAP = 0.062
_DPI = 130
WIDTH_PX, HEIGHT_PX = 1000, 480
_USUAL_WINDOW = 2


@dataclass(frozen=True, slots=True)
class Point:
    """One estimator in the chart: median run time in ms, MARE in degrees by window."""

    name: str
    time_ms: float
    mare_deg: dict[int, float]

    @property
    def window(self) -> int:
        """The default window: 2 for the paper's methods, 1 (none) for the others."""
        return _USUAL_WINDOW if self.name in PAPER else 1

    @property
    def usual_deg(self) -> float:
        """MARE with the default window."""
        return self.mare_deg[self.window]


def draw(result: EstimatorsResult) -> tuple[bytes, Markup]:
    """Return the chart as PNG, and as SVG in the colours of pages.

    The left axes show the error over the run time with the Pareto front, the right axes the error over the
    window.
    """
    points = [point for name in result.timing.contenders if (point := _point(result, name))]
    with drawing(HEIGHT_PX, WIDTH_PX) as figure:
        left, right = figure.subplots(1, 2)
        simulated = "SIMULATED: " if result.simulated else ""
        figure.suptitle(
            f"{simulated}rotational error over {counted(len(result.lifts), 'lift')}, both fingertips fused"
        )
        _front(left, result, points)
        _by_window(right, points)
        return png(figure, _DPI), svg(figure, "Run time against error, and error by window")


def pareto(points: Sequence[Point]) -> list[Point]:
    """Return the Pareto front: points that no other beats in both run time and error, sorted by time."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.time_ms, p.usual_deg)):
        if not front or point.usual_deg < front[-1].usual_deg:
            front.append(point)
    return front


def spread_labels(places: Sequence[float], gap: float) -> list[float]:
    """Return positions of labels, 0 to 1, moved apart to at least `gap` in the same order."""
    order = sorted(range(len(places)), key=lambda i: places[i])
    gap = min(gap, 1.0 / max(len(places) - 1, 1))
    moved = [min(max(places[i], 0.0), 1.0) for i in order]
    for i in range(1, len(moved)):
        moved[i] = max(moved[i], moved[i - 1] + gap)
    highest = 1.0
    for i in reversed(range(len(moved))):
        moved[i] = min(moved[i], highest)
        highest = moved[i] - gap
    result = [0.0] * len(places)
    for i, place in zip(order, moved, strict=True):
        result[i] = place
    return result


def _point(result: EstimatorsResult, name: str) -> Point | None:
    scores = {w: result.scores.get((name, w)) for w in WINDOWS}
    mare = {w: score.mare.mean_deg for w, score in scores.items() if score and score.mare}
    point = Point(name, result.timing.contenders[name].contact.p50_ms, mare)
    return point if mare and point.window in mare else None


def _front(axes: Axes, result: EstimatorsResult, points: Sequence[Point]) -> None:
    front = pareto(points)
    axes.plot(
        [p.time_ms for p in front], [p.usual_deg for p in front],
        color=LINE.light, linewidth=7, solid_capstyle="round", zorder=1,
    )  # fmt: skip
    for point in points:
        values = list(point.mare_deg.values())
        style = _style(point.name)
        axes.plot([point.time_ms] * len(values), values, color=style["color"], linewidth=1, zorder=2)
        axes.plot([point.time_ms], [point.usual_deg], markersize=9, zorder=3, **style)
    axes.set(
        xscale="log", yscale="log", xlabel="frame in to angle out, median, ms (one thread)",
        ylabel="MARE over phases B and C, degrees",
    )  # fmt: skip
    title = "Run time against error\nlines up: windows to 10; grey: nothing is both faster and closer"
    axes.set_title(title, fontsize=11)
    published = result.timing.published.stage
    if published.count:
        axes.axvline(published.p50_ms, color=MUTED.light, linestyle=":", zorder=1)
        axes.text(
            published.p50_ms, 0.66, "published second stage alone", color=MUTED.light, fontsize=10.5,
            rotation=90, ha="center", va="center", transform=axes.get_xaxis_transform(), zorder=5,
            bbox={"facecolor": SHEET.light, "edgecolor": "none", "pad": 2.0},
        )  # fmt: skip
    _finish(axes, [(p.name, p.time_ms, p.usual_deg) for p in points])


def _by_window(axes: Axes, points: Sequence[Point]) -> None:
    shown = [p for p in points if p.name != NO_SKIP]
    for point in shown:
        axes.plot(list(point.mare_deg), list(point.mare_deg.values()), markersize=5, **_style(point.name))
    axes.set(
        yscale="log", xlabel="window: mean of the last n angles (1: none)", xticks=WINDOWS,
        ylabel="MARE over phases B and C, degrees",
    )  # fmt: skip
    axes.set_title("Error by window", fontsize=11)
    _finish(axes, [(p.name, max(p.mare_deg), p.mare_deg[max(p.mare_deg)]) for p in shown])


def _finish(axes: Axes, ends: Sequence[tuple[str, float, float]]) -> None:
    points = [(*end, _style(end[0])["color"]) for end in ends]
    label_points(axes, points, _LABEL_GAP, 1.04, {"linewidth": 0.8})


def label_points(
    axes: Axes,
    points: Sequence[tuple[str, float, float, str]],
    gap: float,
    margin: float,
    line: dict[str, Any],
) -> None:
    """Set plain ticks on logarithmic axes, and write labels in the right margin with a line to each point.

    points: label, x, y, and colour of the line. gap: smallest distance between two labels, as a fraction of
    the axes' height. margin: position of the labels, as a fraction of the axes' width. line: style of the
    lines.
    """
    for axis in (axes.yaxis, axes.xaxis) if axes.get_xscale() == "log" else (axes.yaxis,):
        axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
    low, high = np.log(axes.get_ylim())
    places = spread_labels([float((np.log(y) - low) / (high - low)) for _, _, y, _ in points], gap)
    for (label, x, y, colour), place in zip(points, places, strict=True):
        axes.annotate(
            label, xy=(x, y), xycoords="data", xytext=(margin, place), textcoords="axes fraction",
            va="center", fontsize=10.5, color=INK.light,
            arrowprops={"arrowstyle": "-", "color": colour, **line},
        )  # fmt: skip


def _style(name: str) -> dict[str, Any]:
    color, marker = _LOOKS.get(name.removesuffix(PUBLISHED), _OTHERS)
    hollow = (name in PAPER and name.endswith(PUBLISHED)) or name == NO_SKIP
    return {
        "color": color,
        "marker": marker,
        "markerfacecolor": SHEET.light if hollow else color,
        "linestyle": "--" if hollow else "-",
    }
