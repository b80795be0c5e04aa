"""Figures of errors: boxes by group, and percentiles by angle, rate and time."""

from collections.abc import Sequence
from itertools import pairwise
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes

from drivers.errors import counted
from rig.pages.figure import drawing
from rig.pages.palette import ESTIMATE, INK, MUTED, TRUTH
from rig.pages.plot_data import Spot
from rig.report.curves import rates_deg_s, signed_errors
from rig.report.parts import Chart
from rig.results.metrics import Floats
from rig.sessions.lift_curves import LiftCurves

FEWEST_FRAMES = 30
"""Fewest frames for which percentiles are drawn."""
ANGLE_EDGES_DEG = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0)
RATE_EDGES_DEG_S = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 200.0)
TIME_EDGES_S = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 5.0)
_ROW_PX = 27
_LABEL_CHARACTERS = 22


def boxes(
    groups: dict[str, Floats],
    title: str,
    caption: str,
    label: str = "|RE|, degrees",
    least: float | None = 0.0,
    mark: float | None = None,
) -> Chart:
    """Draw a box plot per group: quartiles, median, and whiskers to minimum and maximum.

    groups: values (N,) by name, absolute errors in deg unless `label` states another unit; empty groups are
    written, not drawn. least: beginning of the scale, None for that of the values. mark: value at which a
    dashed line is drawn.
    """
    names = list(groups)
    with drawing(70 + _ROW_PX * max(len(names), 2)) as figure:
        axes = figure.subplots()
        filled = [(i, values) for i, values in enumerate(groups.values()) if values.size]
        if filled:
            _draw_boxes(axes, filled)
        for i, values in enumerate(groups.values()):
            if not values.size:
                beside = axes.get_yaxis_transform()
                axes.text(0.0, i, " no answer", va="center", color=MUTED.light, transform=beside)
        axes.set_yticks(range(len(names)), [fill(name, _LABEL_CHARACTERS) for name in names])
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.set_xlim(left=least)
        if mark is not None:
            axes.axvline(mark, color=TRUTH.light, dashes=(4, 2), zorder=1)
        axes.grid(False, axis="y")
        axes.set_xlabel(label)
        spots = [
            Spot(float(x), i, f"{names[i]}: {_five_numbers(values)}")
            for i, values in filled
            for x in np.percentile(values, (0, 25, 50, 75, 100))
        ]
        return Chart(title, figure, caption, spots=spots)


def _five_numbers(values: Floats) -> str:
    least, first, median, third, largest = np.percentile(values, (0, 25, 50, 75, 100))
    return (
        f"median {median:.2f}, middle half {first:.2f} to {third:.2f}, "
        f"least {least:.2f}, largest {largest:.2f}; {counted(values.size, 'value')}"
    )


def _draw_boxes(axes: Axes, filled: Sequence[tuple[int, Floats]]) -> None:
    axes.boxplot(
        [values for _, values in filled], positions=[i for i, _ in filled], orientation="horizontal",
        whis=(0, 100), widths=0.6, patch_artist=True, manage_ticks=False,
        boxprops={"facecolor": ESTIMATE.light, "alpha": 0.35, "edgecolor": ESTIMATE.light},
        medianprops={"color": INK.light, "linewidth": 2},
        whiskerprops={"color": MUTED.light}, capprops={"color": MUTED.light},
    )  # fmt: skip


def error_against_angle(lifts: Sequence[LiftCurves]) -> Chart:
    """Draw the error over the rotation of the object."""
    sizes = [np.abs(lift.truth.at(lift.estimate.time_s)) for lift in lifts]
    return _against(
        lifts, sizes, ANGLE_EDGES_DEG, "Error against angle", "marker angle, degrees",
        "Absolute error over the rotation of the markers since the zero.",
    )  # fmt: skip


def error_over_time(lifts: Sequence[LiftCurves]) -> Chart:
    """Draw the error over the time in a lift."""
    return _against(
        lifts, [lift.estimate.time_s for lift in lifts], TIME_EDGES_S, "Error over time",
        "time from the start of the lift, s", "Absolute error over the time since phase B began.",
    )  # fmt: skip


def error_against_rate(lifts: Sequence[LiftCurves]) -> Chart:
    """Draw the error over the rate of rotation of the object."""
    return _against(
        lifts, [np.abs(rates_deg_s(lift)) for lift in lifts], RATE_EDGES_DEG_S, "Error against rate",
        "marker rate, degrees/s", "Absolute error over the rate of rotation of the markers (over 0.1 s).",
    )  # fmt: skip


def _against(
    lifts: Sequence[LiftCurves],
    by: Sequence[Floats],
    edges: tuple[float, ...],
    title: str,
    label: str,
    what: str,
) -> Chart:
    errors = np.concatenate([np.zeros(0), *(np.abs(signed_errors(lift)) for lift in lifts)])
    values = np.concatenate([np.zeros(0), *by])
    inside = np.concatenate([np.zeros(0, bool), *(lift.within("B", "C") for lift in lifts)])
    known = inside & np.isfinite(errors) & np.isfinite(values)
    errors, values = errors[known], values[known]
    with drawing(250) as figure:
        axes = figure.subplots()
        spots = _percentiles(axes, errors, values, edges)
        axes.set(xlabel=label, ylabel="|RE|, degrees")
        axes.set_ylim(bottom=0.0)
        caption = f"{what} Median with the middle half and the middle 90 % of the frames; their number above."
        return Chart(title, figure, caption, spots=spots)


def _percentiles(axes: Axes, errors: Floats, values: Floats, edges: tuple[float, ...]) -> list[Spot]:
    """Draw the percentiles of the errors in each bin of the values; return the values of each."""
    bins = list(pairwise(edges))
    groups = [(a, b, errors[(values >= a) & (values < b)]) for a, b in bins]
    groups = [group for group in groups if group[2].size >= FEWEST_FRAMES]
    axes.set_xticks(range(len(groups)), [f"{a:g}-{b:g}" for a, b, _ in groups])
    axes.grid(False, axis="x")
    if not groups:
        axes.text(0.5, 0.5, "too few frames", ha="center", transform=axes.transAxes, color=MUTED.light)
        return []
    axes.set_xlim(-0.6, len(groups) - 0.4)
    spots = []
    for i, (begin, end, group) in enumerate(groups):
        low, first, middle, third, high = np.percentile(group, [5, 25, 50, 75, 95])
        axes.plot([i, i], [low, high], color=ESTIMATE.light)
        axes.plot(
            [i, i], [first, third], color=ESTIMATE.light, linewidth=9, alpha=0.45, solid_capstyle="butt"
        )
        text = (
            f"{begin:g} to {end:g}: median {middle:.2f}, middle half {first:.2f} to {third:.2f}, "
            f"middle 90 % {low:.2f} to {high:.2f}; {counted(group.size, 'frame')}"
        )
        spots += [Spot(i, float(y), text) for y in (low, first, middle, third, high)]
        axes.plot([i], [middle], "o", color=INK.light, markersize=5)
        axes.text(
            i, 1.0, f"{group.size}", ha="center", va="bottom", fontsize=9.5, color=MUTED.light,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    return spots
