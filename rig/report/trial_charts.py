"""The figures of a trial: the paper's box plot, and how the error depends on angle and rate."""

from collections.abc import Sequence
from itertools import pairwise
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from rig.pages.figure import drawing, legend_above
from rig.pages.palette import BAD, ESTIMATE, GOOD, INK, MUTED, SECOND, TRUTH
from rig.report.curves import LiftCurves, rates_deg_s, signed_errors, truth_at
from rig.report.parts import Chart
from rig.results.metrics import Floats
from rig.sessions.records import FinishedLift, LiftOutcome

FEWEST_FRAMES = 30
"""Fewer frames than this make no percentile worth drawing."""
ANGLE_EDGES_DEG = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0)
RATE_EDGES_DEG_S = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 200.0)
TIME_EDGES_S = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 5.0)
_OUTCOMES = {
    LiftOutcome.SLIPPED: ESTIMATE,
    LiftOutcome.HELD: GOOD,
    LiftOutcome.CAUGHT: SECOND,
    LiftOutcome.FALLEN: BAD,
}
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
    """A box per group from the first to the third quartile, the median, and whiskers to least and most.

    groups: values (N,) by name, absolute errors in deg unless `label` says otherwise; empty groups are
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
        return Chart(title, figure, caption)


def _draw_boxes(axes: Axes, filled: Sequence[tuple[int, Floats]]) -> None:
    axes.boxplot(
        [values for _, values in filled], positions=[i for i, _ in filled], orientation="horizontal",
        whis=(0, 100), widths=0.6, patch_artist=True, manage_ticks=False,
        boxprops={"facecolor": ESTIMATE.light, "alpha": 0.35, "edgecolor": ESTIMATE.light},
        medianprops={"color": INK.light, "linewidth": 2},
        whiskerprops={"color": MUTED.light}, capprops={"color": MUTED.light},
    )  # fmt: skip


def error_against_angle(lifts: Sequence[LiftCurves]) -> Chart:
    """Error over how far the object had turned."""
    sizes = [np.abs(truth_at(lift.truth, lift.estimate.time_s)) for lift in lifts]
    return _against(
        lifts, sizes, ANGLE_EDGES_DEG, "Error against angle", "marker angle, degrees",
        "Absolute error by how far the markers had turned since the zero.",
    )  # fmt: skip


def error_over_time(lifts: Sequence[LiftCurves]) -> Chart:
    """Error over the time in a lift."""
    return _against(
        lifts, [lift.estimate.time_s for lift in lifts], TIME_EDGES_S, "Error over time",
        "time from the start of the lift, s", "Absolute error by the time since phase B began.",
    )  # fmt: skip


def grip_chart(rows: Sequence[FinishedLift]) -> Chart | None:
    """True turn of each lift over its grip, by outcome; None if no lift has a true turn."""
    known = [(row.grip_counts, abs(row.final_truth_deg), row.outcome) for row in rows if row.final_truth_deg]
    if not known:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for (outcome, colour), marker in zip(_OUTCOMES.items(), "osD^", strict=True):
            own = [(grip, turn) for grip, turn, ended in known if ended is outcome]
            if own:
                axes.plot(*zip(*own, strict=True), marker, color=colour.light, markersize=5, alpha=0.75,
                          label=outcome.value)  # fmt: skip
        axes.set(xlabel="grip, steps past first contact", ylabel="true turn at the end, degrees")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        legend_above(axes, 4)
        caption = "One symbol per lift: the absolute true turn at its end."
        return Chart("Grip and outcome", figure, caption)


def error_against_rate(lifts: Sequence[LiftCurves]) -> Chart:
    """Error over how fast the object turned."""
    return _against(
        lifts, [np.abs(rates_deg_s(lift)) for lift in lifts], RATE_EDGES_DEG_S, "Error against rate",
        "marker rate, degrees/s", "Absolute error by how fast the markers turned (over 0.1 s).",
    )  # fmt: skip


def coverage_chart(lifts: Sequence[LiftCurves]) -> Chart | None:
    """How often the error is within the reported sigma; None where no sigma is reported."""
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return None
    from scipy.stats import norm

    multiples = np.linspace(0.0, 4.0, 41)
    seen = [float(np.mean(ratios <= m)) * 100.0 for m in multiples]
    with drawing(250) as figure:
        axes = figure.subplots()
        axes.plot(
            multiples,
            (2 * norm.cdf(multiples) - 1) * 100.0,
            color=MUTED.light,
            dashes=(2, 2),
            label="normal errors",
        )
        axes.plot(multiples, seen, color=ESTIMATE.light, label="this trial")
        axes.set(
            xlabel="multiple of the reported sigma", ylabel="frames within, %", xlim=(0, 4), ylim=(0, 102)
        )
        legend_above(axes, 2)
        title = "Does sigma cover the error?"
        caption = "Below the dashed line sigma is too small, above it too large. Frames of B and C."
        return Chart(title, figure, caption)


def sigma_ratios(lifts: Sequence[LiftCurves]) -> Floats:
    """|error| over the reported sigma of all answered frames in B and C, (N,)."""
    parts = [np.zeros(0)]
    for lift in lifts:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(signed_errors(lift)) / lift.estimate.sigma_deg
        parts.append(ratio[lift.within("B", "C") & np.isfinite(ratio)])
    return np.concatenate(parts)


def finals_chart(lifts: Sequence[tuple[float | None, float | None, str]]) -> Chart | None:
    """Final estimate against final marker angle, deg, of each lift that has both; last its id in the page."""
    known = [(estimate, truth, anchor) for estimate, truth, anchor in lifts if None not in (estimate, truth)]
    if not known:
        return None
    pairs = np.array([values for *values, _ in known], float)
    estimates, truths = pairs.T
    with drawing(290) as figure:
        axes = figure.subplots()
        low, high = min(0.0, float(np.min(pairs))), max(0.0, float(np.max(pairs)))
        room = 0.05 * max(high - low, 2.0)
        reach = (low - room, high + room)
        axes.plot(reach, reach, color=TRUTH.light, dashes=(4, 1.2), label="marker angle")
        axes.scatter(
            truths, estimates, s=25, color=ESTIMATE.light, alpha=0.75, label="estimate, one per lift",
            urls=[f"#{anchor}" for _, _, anchor in known],
        )  # fmt: skip
        axes.set(xlabel="final marker angle, degrees", ylabel="final estimate, degrees", aspect="equal")
        axes.set(xlim=reach, ylim=reach)
        legend_above(axes, 2)
        title = "Where the lifts ended"
        return Chart(title, figure, "Both angles over the last moments of C; on the line they agree.")


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
        _percentiles(axes, errors, values, edges)
        axes.set(xlabel=label, ylabel="|RE|, degrees")
        axes.set_ylim(bottom=0.0)
        caption = f"{what} Median with the middle half and the middle 90 % of the frames; their number above."
        return Chart(title, figure, caption)


def _percentiles(axes: Axes, errors: Floats, values: Floats, edges: tuple[float, ...]) -> None:
    bins = list(pairwise(edges))
    groups = [(a, b, errors[(values >= a) & (values < b)]) for a, b in bins]
    groups = [group for group in groups if group[2].size >= FEWEST_FRAMES]
    axes.set_xticks(range(len(groups)), [f"{a:g}-{b:g}" for a, b, _ in groups])
    axes.grid(False, axis="x")
    if not groups:
        axes.text(0.5, 0.5, "too few frames", ha="center", transform=axes.transAxes, color=MUTED.light)
        return
    axes.set_xlim(-0.6, len(groups) - 0.4)
    for i, (_, _, group) in enumerate(groups):
        low, first, middle, third, high = np.percentile(group, [5, 25, 50, 75, 95])
        axes.vlines(i, low, high, color=ESTIMATE.light, linewidth=1.5)
        axes.vlines(i, first, third, color=ESTIMATE.light, linewidth=9, alpha=0.45)
        axes.plot([i], [middle], "o", color=INK.light, markersize=5)
        axes.text(
            i, 1.0, f"{group.size}", ha="center", va="bottom", fontsize=9.5, color=MUTED.light,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
