"""The page of a comparison, with its chart."""

from collections.abc import Sequence
from dataclasses import replace
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes

from rig.pages.figure import Spot, drawing
from rig.pages.page import render
from rig.pages.palette import FIRST, INK, MUTED, SECOND, TRUTH
from rig.report.compare import ERROR, Comparison, Paired, differences, verdict
from rig.report.explored import explored, pair_panels
from rig.report.lift_chart import pair_chart
from rig.report.parts import Chart, Table, made_text
from rig.results.metrics import FEWEST_LIFTS, INTERVAL

_ROW_PX = 30
_JITTER = 0.22
_LINE, _NAME = 46, 14
"""Number of characters that fit below the axes, and of a name at either side above them."""


def compare_page(comparison: Comparison, simulated: bool, about: str, notes: Sequence[str] = ()) -> str:
    """Return the comparison as one HTML page.

    about: description of the sides. notes: parts of them that could not be read.
    """
    return render(
        "rig.report",
        "compare.html",
        names=comparison.names,
        simulated=simulated,
        about=about,
        verdict=verdict(comparison),
        won=comparison.error is not None and comparison.error.winner is not None,
        interval=INTERVAL,
        fewest=FEWEST_LIFTS,
        chart=difference_chart(comparison) if comparison.error else None,
        apart=[each.text for each in comparison.apart],
        figures=_table(comparison, "figure", [(p.figure.name, p) for p in comparison.overall]),
        objects=_table(comparison, "object", list(comparison.objects.items())),
        lifts=lift_charts(comparison),
        alone=comparison.alone,
        notes=notes,
        colours=(FIRST.css, SECOND.css),
        truth=TRUTH.css,
        made=made_text(),
    )


def difference_chart(comparison: Comparison) -> Chart:
    """Draw the differences of the mean error in B and C: a dot per lift, and the interval per object."""
    first, second = (shorten(name) for name in comparison.names)
    rows = list(comparison.objects.items())
    total = comparison.error
    with drawing(90 + _ROW_PX * (len(rows) + 1), 430) as figure:
        axes = figure.subplots()
        axes.axvline(0.0, color=INK.light, linewidth=1.0)
        spots = []
        for i, (name, own) in enumerate(rows):
            spots += [*_dots(axes, i, comparison, name), _bar(axes, i, name, own)]
        if total is not None:
            spots.append(_bar(axes, len(rows), "all lifts", total))
        axes.set_yticks(range(len(rows) + 1), [*(name for name, _ in rows), "all lifts"])
        axes.set_ylim(len(rows) + 0.6, -0.6)
        axes.grid(False, axis="y")
        reach = 1.1 * max(float(np.abs(axes.get_xlim()).max()), 0.1)
        axes.set_xlim(-reach, reach)
        axes.set_xlabel(fill(f"mean error of {second} minus that of {first}, degrees", _LINE))
        above = {"transform": axes.transAxes, "va": "bottom", "color": MUTED.light}
        axes.text(0.0, 1.01, f"\u25c0 {second} is closer", ha="left", **above)
        axes.text(1.0, 1.01, f"{first} is closer \u25b6", ha="right", **above)
        title = "Which side is closer to the markers, by object"
        caption = "A dot per lift; the tick is the mean of the differences, the bar its 95 % interval."
        return Chart(title, figure, caption, f"{title}: {first} and {second}", spots=spots)


def lift_charts(comparison: Comparison) -> list[Chart]:
    """Draw both sides' curves of every lift with curves, largest difference of the mean error first."""
    charts = []
    for first, second in comparison.pairs:
        if first.curves is None or second.curves is None:
            continue
        errors = [lift.re for lift in (first, second)]
        apart = [error.mean_deg for error in errors if error is not None]
        rank = abs(apart[1] - apart[0]) if len(apart) == 2 else -1.0
        parts = [
            f"{shorten(name)}: "
            + ("no answer" if error is None else f"mean error {error.mean_deg:.2f}\u00b0")
            for name, error in zip(comparison.names, errors, strict=True)
        ]
        chart = pair_chart(first.curves, second.curves, "; ".join(parts))
        data = explored(first.curves, pair_panels(comparison.names, first.curves, second.curves))
        charts.append((rank, replace(chart, anchor=f"lift-{len(charts) + 1}", explored=data)))
    return [chart for _, chart in sorted(charts, key=lambda entry: -entry[0])]


def shorten(name: str) -> str:
    """Return the end of a name that is too long for the chart; sessions begin with their date."""
    return name if len(name) <= _NAME else "\u2026" + name[1 - _NAME :]


def _table(comparison: Comparison, head: str, named: Sequence[tuple[str, Paired]]) -> Table:
    first, second = comparison.names
    better = (f"{first} better", f"{second} better")
    columns = (head, first, second, "difference [95 %]", "lifts", *better, "shown to win")
    return Table(columns, [_cells(name, each, comparison) for name, each in named])


def _cells(name: str, p: Paired, comparison: Comparison) -> list[str]:
    digits = {"s": 3, "%": 1}.get(p.figure.unit, 2)
    unit = f" {p.figure.unit}" if p.figure.unit != "°" else p.figure.unit
    interval = "" if p.low is None else f" [{p.low:+z.{digits}f}, {p.high:+z.{digits}f}]"
    lifts = f"{p.lifts} of {p.lifts + p.missing}" if p.missing else str(p.lifts)
    winner = "-" if p.winner is None else comparison.names[p.winner]
    wins = ["-", "-"] if p.figure.smaller is None else [str(p.wins[0]), str(p.wins[1])]
    sides = [f"{p.first:.{digits}f}{unit}", f"{p.second:.{digits}f}{unit}"]
    return [name, *sides, f"{p.difference:+z.{digits}f}{interval}", lifts, *wins, winner]


def _dots(axes: Axes, row: int, comparison: Comparison, name: str) -> list[Spot]:
    """Draw a dot per lift of an object; return the values of each."""
    own = [pair for pair in comparison.pairs if pair[0].label == name]
    known = [pair[0] for pair in own if None not in map(ERROR.value, pair)]
    first, second = differences(ERROR, own)
    away = second - first
    places = row + np.linspace(-_JITTER, _JITTER, len(away)) if len(away) > 1 else np.array([row], float)
    for side, colour, marker in ((away > 0, FIRST, "o"), (away < 0, SECOND, "D"), (away == 0, MUTED, "x")):
        axes.plot(away[side], places[side], marker, color=colour.light, markersize=4.5, alpha=0.8)
    return [
        Spot(float(x), float(y), f"{row.title}: {one:.2f}° and {two:.2f}°, difference {x:+.2f}°")
        for row, x, y, one, two in zip(known, away, places, first, second, strict=True)
    ]


def _bar(axes: Axes, row: int, name: str, p: Paired) -> Spot:
    """Draw the mean difference with its interval; return its values."""
    text = f"{name}: mean difference {p.difference:+.2f}°"
    if p.low is not None and p.high is not None:
        axes.plot([p.low, p.high], [row, row], color=INK.light, linewidth=2.0, solid_capstyle="butt")
        text += f", 95 % interval {p.low:+.2f}° to {p.high:+.2f}°"
    axes.plot([p.difference], [row], "|", color=INK.light, markersize=13, markeredgewidth=2.5)
    return Spot(p.difference, row, text)
