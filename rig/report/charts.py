"""Charts over many lifts."""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from drivers.errors import InputError, counted
from protocols.grasps import GraspFile, find_grasp_file
from rig.pages.figure import Spot, drawing, legend_above
from rig.pages.palette import BAD, ESTIMATE, GOOD, INK, MUTED, SECOND, TRUTH
from rig.report.parts import Chart, anchor
from rig.results.metrics import Floats
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.records import Lift, LiftOutcome

FEWEST_FRAMES = 30
"""Fewest frames for which percentiles are drawn."""
PAPER_MARE_DEG = 1.85
"""Castano-Amoros and Gil 2023, Table III: MARE of 45 lifts of its nine objects."""
SURFACES = ("edge", "flat", "cylinder", "ball")
_ROW_PX = 27
_LABEL_CHARACTERS = 22
_OUTCOMES = {
    LiftOutcome.SLIPPED: (ESTIMATE, "o"),
    LiftOutcome.HELD: (GOOD, "s"),
    LiftOutcome.CAUGHT: (SECOND, "D"),
    LiftOutcome.FALLEN: (BAD, "^"),
}


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
    spots = []
    with drawing(70 + _ROW_PX * max(len(groups), 2)) as figure:
        axes = figure.subplots()
        if filled := {i: values for i, values in enumerate(groups.values()) if values.size}:
            axes.boxplot(
                list(filled.values()), positions=list(filled), orientation="horizontal",
                whis=(0, 100), widths=0.6, patch_artist=True, manage_ticks=False,
                boxprops={"facecolor": ESTIMATE.light, "alpha": 0.35, "edgecolor": ESTIMATE.light},
                medianprops={"color": INK.light, "linewidth": 2},
                whiskerprops={"color": MUTED.light}, capprops={"color": MUTED.light},
            )  # fmt: skip
        for i, (name, values) in enumerate(groups.items()):
            if not values.size:
                beside = axes.get_yaxis_transform()
                axes.text(0.0, i, " no answer", va="center", color=MUTED.light, transform=beside)
                continue
            five = np.percentile(values, (0, 25, 50, 75, 100))
            lowest, first, median, third, largest = five
            text = (
                f"{name}: median {median:.2f}, middle half {first:.2f} to {third:.2f}, "
                f"least {lowest:.2f}, largest {largest:.2f}; {counted(values.size, 'value')}"
            )
            spots += [Spot(float(x), i, text) for x in five]
        axes.set_yticks(range(len(groups)), [fill(name, _LABEL_CHARACTERS) for name in groups])
        axes.set_ylim(len(groups) - 0.4, -0.6)
        axes.set_xlim(left=least)
        if mark is not None:
            axes.axvline(mark, color=TRUTH.light, dashes=(4, 2), zorder=1)
        axes.grid(False, axis="y")
        axes.set_xlabel(label)
        return Chart(title, figure, caption, spots=spots)


def _rate_deg_s(lift: LiftCurves) -> Floats:
    """Return the rate of the markers at each frame of the estimate, (N,) deg/s, over 0.1 s around it."""
    times, half_s = lift.estimate.time_s, 0.05
    return (lift.truth.at(times + half_s) - lift.truth.at(times - half_s)) / (2 * half_s)


AGAINST: dict[str, tuple[str, str, tuple[float, ...], Callable[[LiftCurves], Floats]]] = {
    "Error over time": (
        "time from the start of the lift, s", "Absolute error over the time since phase B began.",
        (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 5.0), lambda lift: lift.estimate.time_s,
    ),
    "Error against angle": (
        "marker angle, degrees", "Absolute error over the rotation of the markers since the zero.",
        (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0),
        lambda lift: np.abs(lift.truth.at(lift.estimate.time_s)),
    ),
    "Error against rate": (
        "marker rate, degrees/s", "Absolute error over the rate of rotation of the markers (over 0.1 s).",
        (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 200.0), lambda lift: np.abs(_rate_deg_s(lift)),
    ),
}  # fmt: skip
"""Charts of percentiles of the error, by title: label and caption, edges of the bins, and what is binned."""


def error_against(title: str, lifts: Sequence[LiftCurves]) -> Chart:
    """Draw percentiles of the errors in phases B and C. title: in `AGAINST`."""
    label, what, edges, binned = AGAINST[title]
    errors = np.concatenate([np.zeros(0), *(np.abs(lift.error_deg) for lift in lifts)])
    values = np.concatenate([np.zeros(0), *map(binned, lifts)])
    inside = np.concatenate([np.zeros(0, bool), *(lift.within("B", "C") for lift in lifts)])
    known = inside & np.isfinite(errors) & np.isfinite(values)
    with drawing(250) as figure:
        axes = figure.subplots()
        spots = _percentiles(axes, errors[known], values[known], edges)
        axes.set(xlabel=label, ylabel="|RE|, degrees")
        axes.set_ylim(bottom=0.0)
        caption = f"{what} Median with the middle half and the middle 90 % of the frames; their number above."
        return Chart(title, figure, caption, spots=spots)


def _percentiles(axes: Axes, errors: Floats, values: Floats, edges: tuple[float, ...]) -> list[Spot]:
    """Draw the percentiles of the errors in each bin of the values; return the values of each."""
    groups = [(a, b, errors[(values >= a) & (values < b)]) for a, b in pairwise(edges)]
    groups = [group for group in groups if group[2].size >= FEWEST_FRAMES]
    axes.set_xticks(range(len(groups)), [f"{a:g}-{b:g}" for a, b, _ in groups])
    axes.grid(False, axis="x")
    if not groups:
        axes.text(0.5, 0.5, "too few frames", ha="center", transform=axes.transAxes, color=MUTED.light)
        return []
    axes.set_xlim(-0.6, len(groups) - 0.4)
    spots, above = [], axes.get_xaxis_transform()
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
        number = {"fontsize": 9.5, "color": MUTED.light, "transform": above}
        axes.text(i, 1.0, f"{group.size}", ha="center", va="bottom", **number)
    return spots


def grip_chart(lifts: Sequence[Lift]) -> Chart | None:
    """Draw the true final rotation of each lift over its grip, by outcome; None without ground truth."""
    known = [(lift, abs(turn)) for lift in lifts if (turn := lift.final_truth_deg)]
    if not known:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for outcome, (colour, marker) in _OUTCOMES.items():
            own = [(lift.grip_counts, turn) for lift, turn in known if lift.outcome is outcome]
            if own:
                axes.plot(*zip(*own, strict=True), marker, color=colour.light, markersize=5, alpha=0.75,
                          label=outcome.value)  # fmt: skip
        axes.set(xlabel="grip, steps past first contact", ylabel="true turn at the end, degrees")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        legend_above(axes, 4)
        caption = "One symbol per lift: the absolute true turn at its end."
        spots = [
            Spot(lift.grip_counts, turn, f"{lift.title}: grip {lift.grip_counts}, turned {turn:.1f}°, "
                 f"{lift.outcome.value}", anchor(lift))
            for lift, turn in known
        ]  # fmt: skip
        return Chart("Grip and outcome", figure, caption, spots=spots)


def coverage_chart(lifts: Sequence[LiftCurves]) -> Chart | None:
    """Draw the fraction of errors within multiples of the reported sigma; None without sigmas."""
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return None
    from scipy.stats import norm

    multiples = np.linspace(0.0, 4.0, 41)
    seen = [float(np.mean(ratios <= m)) * 100.0 for m in multiples]
    normal = (2 * norm.cdf(multiples) - 1) * 100.0
    with drawing(250) as figure:
        axes = figure.subplots()
        axes.plot(multiples, normal, color=MUTED.light, dashes=(2, 2), label="normal errors")
        axes.plot(multiples, seen, color=ESTIMATE.light, label="this trial")
        axes.set(xlabel="multiple of the reported sigma", ylabel="frames within, %", xlim=(0, 4))
        axes.set_ylim(0, 102)
        legend_above(axes, 2)
        caption = "Below the dashed line sigma is too small, above it too large. Frames of B and C."
        spots = [
            Spot(float(m), s, f"within {m:.1f} sigma: {s:.1f} % of the frames; normal errors: {n:.1f} %")
            for m, s, n in zip(multiples, seen, normal, strict=True)
        ]
        return Chart("Does sigma cover the error?", figure, caption, spots=spots)


def sigma_ratios(lifts: Sequence[LiftCurves]) -> Floats:
    """Return |error| / sigma of all frames with an angle in B and C, (N,)."""
    parts = [np.zeros(0)]
    for lift in lifts:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(lift.error_deg) / lift.estimate.sigma_deg
        parts.append(ratio[lift.within("B", "C") & np.isfinite(ratio)])
    return np.concatenate(parts)


def finals_chart(lifts: Sequence[Lift]) -> Chart | None:
    """Draw final estimates over final marker angles, for lifts with both; None if no lift has both."""
    spots = [
        Spot(lift.final_truth_deg, lift.final_estimate_deg, f"{lift.title}: estimate "
             f"{lift.final_estimate_deg:+.1f}°, markers {lift.final_truth_deg:+.1f}°", anchor(lift))
        for lift in lifts
        if lift.final_estimate_deg is not None and lift.final_truth_deg is not None
    ]  # fmt: skip
    if not spots:
        return None
    pairs = np.array([(spot.x, spot.y) for spot in spots])
    low, high = min(0.0, float(np.min(pairs))), max(0.0, float(np.max(pairs)))
    room = 0.05 * max(high - low, 2.0)
    reach = (low - room, high + room)
    with drawing(290) as figure:
        axes = figure.subplots()
        axes.plot(reach, reach, color=TRUTH.light, dashes=(4, 1.2), label="marker angle")
        axes.plot(
            *pairs.T, "o", markersize=5, color=ESTIMATE.light, alpha=0.75, label="estimate, one per lift"
        )
        axes.set(xlabel="final marker angle, degrees", ylabel="final estimate, degrees", aspect="equal")
        axes.set(xlim=reach, ylim=reach)
        legend_above(axes, 2)
        caption = "Means over the end of C. Points on the line have no error."
        return Chart("Final angles", figure, caption, spots=spots)


def errors_by(lifts: Sequence[Lift], group: Callable[[Lift], str]) -> dict[str, Floats]:
    """Return the absolute errors in phase B, (N,) deg, by the group of their lift."""
    found: dict[str, list[Floats]] = {}
    for lift in lifts:
        found.setdefault(group(lift), []).append(lift.curves.errors("B") if lift.curves else np.zeros(0))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def object_chart(lifts: Sequence[Lift]) -> Chart:
    """Draw the paper's box plot: a box per object over all frames of phase B."""
    caption = (
        "All frames of phase B, as in the paper's figure: median, quartiles, whiskers from least to most. "
        f"Dashed: {PAPER_MARE_DEG}°, the paper's mean over all objects on its real bench; it prints no "
        "number per object."
    )
    groups = errors_by(lifts, lambda lift: lift.label)
    return boxes(groups, "Rotational error per object", caption, mark=PAPER_MARE_DEG)


def surface_chart(lifts: Sequence[Lift], own: Sequence[GraspFile] = ()) -> Chart | None:
    """Draw a box per kind of surface in the object files; None if there are fewer than two kinds.

    own: a lab's objects, as stored in the session.
    """
    groups = errors_by(lifts, lambda lift: surface(lift, own))
    counts = Counter(surface(lift, own) for lift in lifts)
    groups = {f"{s} ({counted(counts[s], 'lift')})": groups[s] for s in SURFACES if s in groups}
    caption = (
        "Phase B, by what the fingers hold (as the object files name it): the paper's edge and cylinder."
    )
    return None if len(groups) < 2 else boxes(groups, "Error by grasped surface", caption)


def surface(lift: Lift, own: Sequence[GraspFile] = ()) -> str:
    """Return the surface at the lift's grasp position in the object file; "" if it is not given."""
    try:
        grasps = find_grasp_file(lift.object, own)
    except InputError:
        return ""
    place = next((p for p in grasps.position if p.name == lift.position), None)
    return (place.surface or "") if place else ""
