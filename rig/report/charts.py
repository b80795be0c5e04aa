"""Charts: over many lifts, of one lift over time, and the growing curve of a film."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivers.errors import InputError, plural
from drivers.types import Image
from protocols.grasps import GraspFile, find_grasp_file
from rig.pages.figure import PX_PER_INCH, Spot, add_axes, band, drawing, legend_above, limits
from rig.pages.palette import (
    BAD,
    ESTIMATE,
    FIRST,
    GOOD,
    INK,
    MUTED,
    PAPER,
    PHASE,
    SECOND,
    STATES,
    TRUTH,
    Colour,
)
from rig.report.parts import Chart, anchor
from rig.report.strips import rgb
from rig.results.metrics import USEFUL_SIGMA_DEG, Floats
from rig.sessions.records import Lift, LiftOutcome
from rig.tactile.angles import FUSED, MARKERS, Angles

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
                medianprops={"color": INK.light, "linewidth": 2}, label="quartiles and range",
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
                f"least {lowest:.2f}, largest {largest:.2f}; {plural(values.size, 'value')}"
            )
            spots += [Spot(float(x), i, text) for x in five]
        axes.set_yticks(range(len(groups)), [fill(name, _LABEL_CHARACTERS) for name in groups])
        axes.set_ylim(len(groups) - 0.4, -0.6)
        axes.set_xlim(left=least)
        if mark is not None:
            axes.axvline(mark, color=TRUTH.light, dashes=(4, 2), zorder=1, label=f"{mark:g}\u00b0, the paper")
        axes.grid(False, axis="y")
        axes.set_xlabel(label)
        return Chart(title, figure, caption, spots=spots)


def _rate_deg_s(lift: Lift) -> Floats:
    """Return the rate of the markers at each frame of the estimate, (N,) deg/s, over 0.1 s around it."""
    times, half_s = lift.estimate.time_s, 0.05
    return (lift.truth.at(times + half_s) - lift.truth.at(times - half_s)) / (2 * half_s)


AGAINST: dict[str, tuple[str, str, tuple[float, ...], Callable[[Lift], Floats]]] = {
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
"""Charts of percentiles of the error, by title: label, caption, edges of the bins, and binned quantity."""


def error_against(title: str, lifts: Sequence[Lift]) -> Chart:
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
        ninety, half, median = ("", "", "") if i else ("middle 90 %", "middle half", "median")
        axes.plot([i, i], [low, high], color=ESTIMATE.light, label=ninety)
        axes.plot(
            [i, i], [first, third], color=ESTIMATE.light, linewidth=9, alpha=0.45, solid_capstyle="butt",
            label=half,
        )  # fmt: skip
        text = (
            f"{begin:g} to {end:g}: median {middle:.2f}, middle half {first:.2f} to {third:.2f}, "
            f"middle 90 % {low:.2f} to {high:.2f}; {plural(group.size, 'frame')}"
        )
        spots += [Spot(i, float(y), text) for y in (low, first, middle, third, high)]
        axes.plot([i], [middle], "o", color=INK.light, markersize=5, label=median)
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


def coverage_chart(lifts: Sequence[Lift]) -> Chart | None:
    """Draw the fraction of errors within multiples of the reported sigma; None without sigmas."""
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return None
    from scipy.special import ndtr  # scipy.stats takes a second to import

    multiples = np.linspace(0.0, 4.0, 41)
    seen = [float(np.mean(ratios <= m)) * 100.0 for m in multiples]
    normal = (2 * ndtr(multiples) - 1) * 100.0
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


def sigma_ratios(lifts: Sequence[Lift]) -> Floats:
    """Return |error| / sigma of all frames with an angle in B and C, (N,)."""
    parts = [np.zeros(0)]
    for lift in lifts:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(lift.error_deg) / lift.estimate.sigma_deg
        parts.append(ratio[lift.within("B", "C") & np.isfinite(ratio)])
    return np.concatenate(parts)


def useful_share(lift: Lift) -> float | None:
    """Return the share of the frames in B and C with a useful angle; None for a lift without sigmas."""
    inside, sigma_deg = lift.within("B", "C"), lift.estimate.sigma_deg
    if not np.isfinite(sigma_deg[inside]).any():
        return None
    return float(
        np.mean(np.isfinite(lift.estimate.angle_deg[inside]) & (sigma_deg[inside] <= USEFUL_SIGMA_DEG))
    )


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
        found.setdefault(group(lift), []).append(lift.errors("B"))
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
    groups = {f"{s} ({plural(counts[s], 'lift')})": groups[s] for s in SURFACES if s in groups}
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


SIGMAS = 2.0
"""Half width of the band around the estimate, in sigma: 95 % of normally distributed errors."""
HEIGHT_PX = 230
_LEAST_SPAN_DEG = 2.0
"""Least range of the angle axis, so that noise at rest does not look like a rotation."""
_LEFT_PX, _TOP_PX, _RIGHT_PX, _BOTTOM_PX, _STATE_PX = 50.0, 18.0, 8.0, 36.0, 8.0
_SHORTEST_S = 0.01
"""Least length at which a curve of one frame is drawn."""
_AFTER_S = 0.15
_MOST_BEFORE = (5.0, 95.0)
"""Percentiles of the angles in phase A that the axes include; angles of first contacts can be arbitrary."""
_FILM_SCALE = 1.25
"""Scale in a film relative to a chart on a page, because films are watched from a larger distance."""
_FILM_TOP_PX, _FILM_BOTTOM_PX = 22, 46
"""Distances of the ends of a film's time line from the panel's edges: at the axes."""
_SOLID, _DASHED, _DOTTED = (1.0, 0.0), (4.0, 1.2), (1.2, 1.2)

Range = tuple[float, float]


Ranges = tuple[Range, Range]
"""Ranges of the axes of a lift's chart, s and deg."""


def lift_chart(lift: Lift, caption: str, ranges: Ranges | None = None) -> Chart:
    """Draw a lift's angles. ranges: of the axes; by default those that fit the lift."""
    with drawing(HEIGHT_PX, arranged=False) as figure:
        draw_lift(figure, lift, ranges)
        what = "estimated and marker angle" if len(lift.truth) else "estimated angle"
        return Chart(lift.title, figure, caption, f"{lift.title}: {what} over time")


def pair_chart(first: Lift, second: Lift, caption: str) -> Chart:
    """Draw one lift with the estimates of both sides of a comparison, and the marker angle of each."""
    with drawing(HEIGHT_PX, arranged=False) as figure:
        both = [replace(of, angles={FUSED: of.estimate, MARKERS: of.truth}) for of in (first, second)]
        shown, other = map(shown_range, both)
        axes = _lift_axes(figure, first, shown, common_ranges(both))
        same = np.array_equal(first.truth.angle_deg, second.truth.angle_deg, equal_nan=True)
        _plot(axes, [(first.truth, TRUTH, _DASHED), (first.estimate, FIRST, _SOLID)], shown)
        _plot(axes, [] if same else [(second.truth, TRUTH, _DOTTED)], other)
        _plot(axes, [(second.estimate, SECOND, _SOLID)], other)
        axes.set_xlabel(_time_label(first), labelpad=1.0)
        return Chart(first.title, figure, caption, f"{first.title}: both estimates and the marker angle")


def common_ranges(lifts: Sequence[Lift]) -> Ranges:
    """Return the smallest ranges that include all lifts, for charts that are compared with each other."""
    starts, ends = zip(*map(shown_range, lifts), strict=True)
    lows, highs = zip(*map(angle_range, lifts), strict=True)
    return (min(starts), max(ends)), (min(lows), max(highs))


def _time_label(lift: Lift) -> str:
    if not len(lift.truth):
        return "time, s"
    return "time from the start of the lift, s" if lift.recording else "time since the first row, s"


def draw_lift(figure: Figure, lift: Lift, ranges: Ranges | None = None, until_s: float = np.inf) -> Axes:
    """Draw a lift's angles and, below them, the states of each fingertip, up to the time `until_s`."""
    tips = [tip for tip in lift.tips.values() if tip.states]
    states_px = _STATE_PX * len(tips)
    ranges = ranges or common_ranges([lift])
    axes = _lift_axes(figure, lift, ranges[0], ranges, states_px)
    estimate, (low, high) = lift.estimate, axes.get_ylim()
    spread = SIGMAS * estimate.sigma_deg
    range_s = ranges[0][0], min(until_s, ranges[0][1])
    shown = _is_in_range(estimate, range_s)
    if np.isfinite(spread[shown]).any():
        spreads = estimate.time_s[shown], estimate.angle_deg[shown], spread[shown]
        band(axes, *spreads, ESTIMATE.light, f"\u00b1{SIGMAS:g} sigma")
    curves = [(lift.truth, TRUTH, _DASHED), (estimate, ESTIMATE, _SOLID)]
    _plot(axes, curves, range_s, ("markers", "estimate"))
    for times, angles in before_lift(lift):
        known = (times <= until_s) & (angles >= low) & (angles <= high)
        axes.plot(times[known], angles[known], color=ESTIMATE.light, linewidth=0.8, alpha=0.7)
    onsets = (lift.onset_truth_s, TRUTH, (4, 2)), (lift.onset_estimate_s, ESTIMATE, (1, 1))
    for onset, colour, dashes in onsets:
        if onset is not None and onset <= until_s:
            axes.axvline(onset, color=colour.light, linewidth=1.2, linestyle=(0, dashes), zorder=1,
                         label="slip begins" if colour is TRUTH else "")  # fmt: skip
    bottom = axes
    if tips:
        height = figure.get_size_inches()[1] * PX_PER_INCH
        bottom = add_axes(figure, _LEFT_PX, height - _BOTTOM_PX - states_px + 3.0, _RIGHT_PX, _BOTTOM_PX)
        bottom.set_xlim(axes.get_xlim())
        axes.tick_params(labelbottom=False)
        _draw_states(bottom, tips, until_s)
    bottom.set_xlabel(_time_label(lift), labelpad=1.0)
    return axes


def _lift_axes(figure: Figure, lift: Lift, shown: Range, ranges: Ranges, below_px: float = 0.0) -> Axes:
    """Return axes with the phases of a lift in its shown range; below_px: more margin at the bottom."""
    axes = add_axes(figure, _LEFT_PX, _TOP_PX, _RIGHT_PX, _BOTTOM_PX + below_px)
    axes.set(xlim=ranges[0], ylim=ranges[1])
    axes.set_ylabel("angle, degrees")
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    start, end = shown
    borders = {name: t for name, t in lift.begins_s.items() if name in ("A", "B", "C", "lower")}
    for name, begins in borders.items():
        ends = min((t for t in borders.values() if t > begins), default=end)
        if name == "lower" or ends <= start:
            continue
        if name == "B":
            axes.axvspan(begins, ends, color=PHASE.light, linewidth=0, zorder=0, label="phase B")
        axes.text(
            (max(begins, start) + min(ends, end)) / 2, 1.0, name, transform=axes.get_xaxis_transform(),
            ha="center", va="bottom", fontsize=10.5, color=MUTED.light,
        )  # fmt: skip
    return axes


def _plot(
    axes: Axes, curves: Sequence[tuple[Angles, Colour, Range]], range_s: Range, labels: Sequence[str] = ()
) -> None:
    """Draw curves in a range of time, each with its colour and dashes, and its label in a legend."""
    for (curve, colour, dashes), label in zip(curves, labels or [""] * len(curves), strict=True):
        shown = _is_in_range(curve, range_s)
        axes.plot(curve.time_s[shown], curve.angle_deg[shown], color=colour.light, dashes=dashes, label=label)


def _is_in_range(curve: Angles, range_s: Range) -> np.ndarray:
    return (curve.time_s >= range_s[0]) & (curve.time_s <= range_s[1])


def _draw_states(axes: Axes, tips: list[Angles], until_s: float) -> None:
    """Draw the states of each fingertip's estimator, one coloured line per fingertip."""
    for row, tip in enumerate(tips):
        changes = [i for i, state in enumerate(tip.states) if i == 0 or state != tip.states[i - 1]]
        for i, after in zip(changes, [*changes[1:], len(tip) - 1], strict=True):
            begins, ends, state = tip.time_s[i], tip.time_s[after], tip.states[i]
            if begins < until_s:
                axes.broken_barh(
                    [(begins, min(ends, until_s) - begins)], (len(tips) - row - 0.9, 0.8),
                    facecolors=STATES[state].light if state in STATES else MUTED.light, linewidth=0,
                    label=state.replace("_", " "),
                )  # fmt: skip
    axes.set_ylim(0, len(tips))
    axes.set_yticks([])
    axes.grid(False)
    axes.spines["left"].set_visible(False)


def shown_range(lift: Lift) -> Range:
    """Return the time range of a lift's chart, s: from the start of A to the end of C."""
    phases_s = lift.begins_s
    if not phases_s:
        times = np.concatenate([lift.estimate.time_s, lift.truth.time_s])
        start = float(times.min()) if times.size else 0.0
        return start, max(float(times.max(initial=start)), start + _SHORTEST_S)
    begins = phases_s.get("A", phases_s.get("B", 0.0) - 1.0)
    curves = (lift.truth, lift.estimate, *lift.tips.values())
    ends = max(float(curve.time_s.max(initial=begins)) for curve in curves)
    return begins, phases_s.get("lower", ends) + _AFTER_S


def angle_range(lift: Lift) -> Range:
    """Return the range of the angle axis of a lift's chart, deg."""
    range_s = shown_range(lift)
    values = [curve.angle_deg[_is_in_range(curve, range_s)] for curve in (lift.estimate, lift.truth)]
    values += [np.percentile(angles, _MOST_BEFORE) for _, angles in before_lift(lift)]
    low, high = limits(*values, room=0.08, least=0.1)
    missing = max(_LEAST_SPAN_DEG - (high - low), 0.0) / 2
    return low - missing, high + missing


def before_lift(lift: Lift) -> list[tuple[Floats, Floats]]:
    """Return each fingertip's angles in phase A, s and deg; angles are fused only from the lift on."""
    phases_s = lift.begins_s
    if "A" not in phases_s or "B" not in phases_s:
        return []
    found = []
    for answered in (tip.known for tip in lift.tips.values()):
        inside = (answered.time_s >= phases_s["A"]) & (answered.time_s < phases_s["B"])
        if inside.any():
            found.append((answered.time_s[inside], answered.angle_deg[inside]))
    return found


def key(states: bool = True, truth: bool = True) -> list[dict[str, str]]:
    """Return the legend of all lift charts. truth: with ground truth and phases, as in a trial."""
    lines = [
        ("line", ESTIMATE, f"estimated angle, with its {SIGMAS:g} sigma band"),
        ("dash", TRUTH, "marker angle"),
        ("line", ESTIMATE, "thin: each fingertip's angle in phase A, before the lift"),
        ("fill", PHASE, "phase B: the arm lifts"),
        ("dash", INK, "vertical: where the slip begins, in the colour of the curve that shows it"),
    ]
    lines = lines if truth else [lines[0], lines[-1]]
    lines += [("fill", colour, name.replace("_", " ")) for name, colour in STATES.items() if states]
    return [{"kind": kind, "colour": colour.css, "text": text} for kind, colour, text in lines]


@dataclass(frozen=True, slots=True, eq=False)
class CurvePanel:
    """The growing curve of a film: drawn once as a whole, then revealed from the left over time.

    whole, axes: images, (H, W, 3) uint8 RGB, of a lift's curves with their axes, and of the axes without
    curves. The time t, in s, is at column `origin_px + t * px_per_s`.
    """

    whole: Image
    axes: Image
    origin_px: float
    px_per_s: float

    def until(self, time_s: float) -> Image:
        """Return the curves up to a time, with a line at that time."""
        column = int(np.clip(round(self.origin_px + time_s * self.px_per_s), 0, self.whole.shape[1] - 1))
        picture = self.axes.copy()
        picture[:, :column] = self.whole[:, :column]
        picture[_FILM_TOP_PX:-_FILM_BOTTOM_PX, column] = rgb(INK.light)
        return picture


def draw_panel(lift: Lift, ranges: Ranges, width_px: int, height_px: int) -> CurvePanel:
    (whole, origin, one), (empty, *_) = (
        _draw(lift, ranges, width_px, height_px, until_s) for until_s in (np.inf, -np.inf)
    )
    return CurvePanel(whole, empty, origin, one - origin)


def _draw(
    lift: Lift, ranges: Ranges, width_px: int, height_px: int, until_s: float
) -> tuple[Image, float, float]:
    """Return the image, and the columns of the times 0 s and 1 s."""
    with drawing(height_px / _FILM_SCALE, width_px / _FILM_SCALE, arranged=False) as figure:
        figure.set_dpi(PX_PER_INCH * _FILM_SCALE)
        figure.set_facecolor(PAPER.light)
        axes = draw_lift(figure, lift, ranges, until_s)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        zero, one = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0]
        return np.asarray(canvas.buffer_rgba())[..., :3].copy(), float(zero), float(one)
