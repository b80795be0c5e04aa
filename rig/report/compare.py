"""Comparison of two measurements of the same lifts: differences, intervals, verdict and page."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes

from drivers.errors import InputError, plural
from protocols.reaction import ReactionKind
from rig.experiments.process_pool import run_in_order
from rig.pages.figure import Spot, drawing
from rig.pages.page import render
from rig.pages.palette import FIRST, INK, MUTED, SECOND, TRUTH
from rig.report.charts import pair_chart
from rig.report.explored import explorer_data, pair_panels
from rig.report.parts import Chart, Table, made_text
from rig.results.metrics import (
    FEWEST_LIFTS,
    INTERVAL,
    Floats,
    Mare,
    mare_of,
    mare_text,
    mean_interval,
    over_lifts,
)
from rig.sessions.records import ErrorSummary, Lift

Pair = tuple[Lift, Lift]
Key = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a lift that is compared. smaller: whether smaller is better; None for no preference.

    of_turn: whether it depends on how the object turns. Lifts with different reactions to slip are not
    compared by such figures.
    """

    name: str
    unit: str
    value: Callable[[Lift], float | None]
    smaller: bool | None = True
    of_turn: bool = False


@dataclass(frozen=True, slots=True)
class Paired:
    """One figure over the lifts of both sides.

    first, second: means of the sides. difference: mean of second - first, with its 95 % interval
    (`mean_interval`; None below `FEWEST_LIFTS`). wins: number of lifts in which the first side is better, the
    second, or neither. lifts: number of pairs with the figure. missing: number of pairs without it on either
    side.
    """

    figure: Figure
    lifts: int
    missing: int
    first: float
    second: float
    difference: float
    low: float | None
    high: float | None
    wins: tuple[int, int, int]

    @property
    def winner(self) -> int | None:
        """Index of the better side if the interval excludes 0, else None."""
        if self.low is None or self.high is None or self.low <= 0.0 <= self.high:
            return None
        if self.figure.smaller is None:
            return None
        return int((self.difference < 0.0) == self.figure.smaller)

    def as_json(self) -> dict[str, object]:
        values = asdict(self)
        figure = values.pop("figure")
        return {**values, "figure": figure["name"], "unit": figure["unit"], "winner": self.winner}


@dataclass(frozen=True, slots=True)
class OwnError:
    """The mean error in B and C over the lifts of one side. mare: None without an answer."""

    name: str
    react: ReactionKind
    mare: Mare | None

    @property
    def reaction(self) -> str:
        return "without a reaction" if self.react is ReactionKind.NONE else f"reaction '{self.react.value}'"

    @property
    def text(self) -> str:
        lifts = f" over {plural(self.mare.lifts, 'lift')}" if self.mare and not self.mare.refused else ""
        return f"{self.name}, {self.reaction}: mean error in B and C {mare_text(self.mare)}{lifts}"

    def as_json(self) -> dict[str, object]:
        mare = self.mare
        return {"name": self.name, "react": self.react.value, "mare_deg": mare and mare.mean_deg}


@dataclass(frozen=True, slots=True)
class Comparison:
    """All figures over all pairs, the mean error per object, and the pairs themselves.

    alone: names of the lifts that exist only on the first side, and only on the second. apart: if the sides
    react to slip differently, the mean error of each over its own lifts, which is not compared; else empty.
    """

    names: tuple[str, str]
    overall: tuple[Paired, ...]
    objects: dict[str, Paired]
    pairs: tuple[Pair, ...]
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    apart: tuple[OwnError, ...] = ()

    @property
    def judged(self) -> bool:
        return self.error is not None and self.error.low is not None

    @property
    def error(self) -> Paired | None:
        """The mean error over B and C, on which the verdict is based; None if no pair has one."""
        return next((p for p in self.overall if p.figure is ERROR), None)

    def as_json(self) -> dict[str, object]:
        return {
            "names": list(self.names),
            "lifts": len(self.pairs),
            "left_out": dict(zip(self.names, self.alone, strict=True)),
            "figures": [each.as_json() for each in self.overall],
            "objects": {name: each.as_json() for name, each in self.objects.items()},
            **({"separately": [each.as_json() for each in self.apart]} if self.apart else {}),
        }


def _mean(error: ErrorSummary | None) -> float | None:
    return error and error.mean_deg


ERROR = Figure("mean error in B and C", "°", lambda lift: _mean(lift.re), of_turn=True)
TIME = Figure("time per tactile frame with contact, median", "ms", lambda lift: lift.frame_ms)
HELD = "mean error if refused frames keep the last angle"
FIGURES = (
    ERROR,
    Figure("mean error in B", "°", lambda lift: _mean(lift.re_b), of_turn=True),
    Figure(HELD, "°", lambda lift: _mean(lift.re_held), of_turn=True),
    Figure("largest error in B and C", "°", lambda lift: lift.re and lift.re.max_deg, of_turn=True),
    Figure("frames with an angle", "%", lambda lift: 100.0 * lift.answered, smaller=False),
    Figure(
        "error of the slip's start",
        "s",
        lambda lift: lift.onset_delay_s and abs(lift.onset_delay_s),
        of_turn=True,
    ),
    TIME,
    Figure(
        "true turn, either way",
        "°",
        lambda lift: lift.final_truth_deg and abs(lift.final_truth_deg),
        smaller=None,
    ),
)


def compare_lifts(
    names: tuple[str, str], first: Iterable[Lift], second: Iterable[Lift], same_estimator: bool = False
) -> Comparison:
    """Compare lifts, paired by object and number. Raises `InputError` if they have no lift in common.

    same_estimator: whether both sides used the same estimator. Then differences of run time are due to the
    load of the computers, and no side is better.
    """
    left, right = ({(lift.object, lift.lift): lift for lift in side} for side in (first, second))
    keys = [key for key in left if key in right]
    if not keys:
        raise InputError(f"{names[0]} and {names[1]} have no lift in common (same object, same number)")
    pairs = tuple((left[key], right[key]) for key in keys)
    alike = tuple(pair for pair in pairs if pair[0].react is pair[1].react)
    figures = [replace(f, smaller=None) if same_estimator and f is TIME else f for f in FIGURES]
    overall = (compare_figure(figure, alike if figure.of_turn else pairs) for figure in figures)
    objects: dict[str, list[Pair]] = {}
    for pair in alike:
        objects.setdefault(pair[0].label, []).append(pair)
    found = {name: compare_figure(ERROR, own) for name, own in objects.items()}
    apart: dict[tuple[str, ReactionKind], list[ErrorSummary | None]] = {}
    for pair in (pair for pair in pairs if pair[0].react is not pair[1].react):
        for name, lift in zip(names, pair, strict=True):
            apart.setdefault((name, lift.react), []).append(lift.re)
    return Comparison(
        names,
        tuple(p for p in overall if p is not None),
        {name: p for name, p in found.items() if p is not None},
        pairs,
        (_alone(left, right), _alone(right, left)),
        tuple(OwnError(*key, mare_of(errors)) for key, errors in apart.items()),
    )


def _alone(mine: Mapping[Key, Lift], others: Mapping[Key, Lift]) -> tuple[str, ...]:
    return tuple(lift.title for key, lift in mine.items() if key not in others)


def differences(figure: Figure, pairs: Iterable[Pair]) -> tuple[Floats, Floats]:
    """Return the figure of the first and second side, (N,) each, for the pairs with a value on both sides."""
    both = [
        (a, b) for x, y in pairs if (a := figure.value(x)) is not None and (b := figure.value(y)) is not None
    ]
    values = np.array(both, float).reshape(-1, 2)
    return values[:, 0], values[:, 1]


def compare_figure(figure: Figure, pairs: Sequence[Pair]) -> Paired | None:
    """Compare one figure; None if no pair has it."""
    first, second = differences(figure, pairs)
    if not first.size:
        return None
    away = second - first
    low, high = mean_interval(away)
    better = away > 0.0 if figure.smaller else away < 0.0
    wins = int(better.sum()), int(((away != 0.0) & ~better).sum()), int((away == 0.0).sum())
    means = [float(values.mean()) for values in (first, second, away)]
    missing = len(pairs) - first.size
    return Paired(figure, first.size, missing, means[0], means[1], means[2], low, high, wins)


def verdict(comparison: Comparison) -> str:
    """Return a sentence: which side has the lower mean error over B and C, or why none."""
    found = comparison.error
    if found is None and comparison.apart:
        return (
            "No verdict: the sides react to slip differently. A lift with a reaction turns less, so the "
            "errors are not comparable. rig report SESSION --beside OTHER compares the rotations."
        )
    if found is None:
        return "No verdict: no lift has an error on both sides."
    first, second = comparison.names
    over = over_lifts(found.lifts, found.missing)
    if found.low is None or found.high is None:
        return f"No verdict {over}: at least {FEWEST_LIFTS} with an error on both sides are needed."
    if found.winner is None:
        more = "more" if found.difference >= 0.0 else "less"
        return (
            f"No significant difference: the error of {second} is {abs(found.difference):.2f}° {more} than "
            f"that of {first} {over}, 95 % interval {found.low:+z.2f} to {found.high:+z.2f}."
        )
    ends = sorted(abs(end) for end in (found.low, found.high))
    return (
        f"{comparison.names[found.winner]} is better by {abs(found.difference):.2f}° "
        f"[{ends[0]:.2f}, {ends[1]:.2f}] {over}."
    )


_ROW_PX = 30
_JITTER = 0.22
_LINE, _NAME = 46, 14
"""Number of characters that fit below the axes, and of a name at either side above them."""


def compare_page(
    comparison: Comparison, simulated: bool, about: str, notes: Sequence[str] = (), jobs: int = 1
) -> str:
    """Return the comparison as one HTML page.

    about: description of the sides. notes: parts of them that could not be read. jobs: processes that draw.
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
        figures=figure_table(comparison),
        objects=object_table(comparison),
        lifts=lift_charts(comparison, jobs),
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


def lift_charts(comparison: Comparison, jobs: int = 1) -> list[Chart]:
    """Draw both sides' curves of every lift with curves, largest difference of the mean error first.

    jobs: processes that draw.
    """
    pairs = [(first, second) for first, second in comparison.pairs if first.angles and second.angles]
    drawn = run_in_order(partial(_drawn_pair, comparison.names), list(enumerate(pairs, start=1)), jobs)
    return [chart for _, chart in sorted(drawn, key=lambda entry: -entry[0])]


def _drawn_pair(names: tuple[str, str], numbered: tuple[int, tuple[Lift, Lift]]) -> tuple[float, Chart]:
    """Return the chart of a pair, drawn, after the difference of its mean errors, -1 without one."""
    number, (first, second) = numbered
    errors = [lift.re for lift in (first, second)]
    apart = [error.mean_deg for error in errors if error is not None]
    rank = abs(apart[1] - apart[0]) if len(apart) == 2 else -1.0
    parts = [
        f"{shorten(name)}: " + ("no answer" if error is None else f"mean error {error.mean_deg:.2f}\u00b0")
        for name, error in zip(names, errors, strict=True)
    ]
    chart = pair_chart(first, second, "; ".join(parts))
    data = explorer_data(first, pair_panels(names, first, second))
    return rank, replace(chart, anchor=f"lift-{number}", explored=data, drawn=chart.draw(), figure=None)


def shorten(name: str) -> str:
    """Return the end of a name that is too long for the chart; sessions begin with their date."""
    return name if len(name) <= _NAME else "\u2026" + name[1 - _NAME :]


def figure_table(comparison: Comparison) -> Table:
    return _table(comparison, "figure", [(p.figure.name, p) for p in comparison.overall])


def object_table(comparison: Comparison) -> Table:
    return _table(comparison, "object", list(comparison.objects.items()))


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
