"""The chart of one lift over time, and the growing curve of a film."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivers.types import Image
from rig.pages.figure import PX_PER_INCH, band, drawing, limits, placed
from rig.pages.palette import ESTIMATE, FIRST, INK, MUTED, PAPER, PHASE, SECOND, STATES, TRUTH, Colour
from rig.report.parts import Chart
from rig.report.strips import rgb
from rig.results.metrics import Floats
from rig.sessions.lift_curves import LiftCurves
from rig.tactile.angles import Angles

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


def lift_chart(lift: LiftCurves, caption: str) -> Chart:
    with drawing(HEIGHT_PX, arranged=False) as figure:
        draw_lift(figure, lift)
        what = "estimated and marker angle" if lift.truth.time_s.size else "estimated angle"
        return Chart(lift.name, figure, caption, f"{lift.name}: {what} over time")


def pair_chart(first: LiftCurves, second: LiftCurves, caption: str) -> Chart:
    """Draw one lift with the estimates of both sides of a comparison, and the marker angle of each."""
    with drawing(HEIGHT_PX, arranged=False) as figure:
        axes = _lift_axes(figure, first, *_common_axes([replace(lift, tips={}) for lift in (first, second)]))
        same = np.array_equal(first.truth.angle_deg, second.truth.angle_deg, equal_nan=True)
        _plot(axes, first, [(first.truth, TRUTH, _DASHED), (first.estimate, FIRST, _SOLID)])
        _plot(axes, second, [] if same else [(second.truth, TRUTH, _DOTTED)])
        _plot(axes, second, [(second.estimate, SECOND, _SOLID)])
        axes.set_xlabel(first.time_label, labelpad=1.0)
        return Chart(first.name, figure, caption, f"{first.name}: both estimates and the marker angle")


def on_one_scale(lifts: Sequence[LiftCurves]) -> list[LiftCurves]:
    """Return the lifts with common axes, for charts that are compared with each other."""
    axes = _common_axes(lifts)
    return [replace(lift, axes=axes) for lift in lifts]


def _common_axes(lifts: Sequence[LiftCurves]) -> tuple[Range, Range]:
    """Return the smallest ranges that include all charts, s and deg."""
    starts, ends = zip(*map(shown_range, lifts), strict=True)
    lows, highs = zip(*map(angle_range, lifts), strict=True)
    return (min(starts), max(ends)), (min(lows), max(highs))


def draw_lift(figure: Figure, lift: LiftCurves, until_s: float = np.inf) -> Axes:
    """Draw a lift's angles and, below them, the states of each fingertip, up to the time `until_s`."""
    tips = [tip for tip in lift.tips.values() if tip.states]
    states_px = _STATE_PX * len(tips)
    axes = _lift_axes(figure, lift, shown_range(lift), angle_range(lift), states_px)
    estimate, (low, high) = lift.estimate, axes.get_ylim()
    spread = SIGMAS * estimate.sigma_deg
    shown = _shown(lift, estimate, until_s)
    if np.isfinite(spread[shown]).any():
        band(axes, estimate.time_s[shown], estimate.angle_deg[shown], spread[shown], ESTIMATE.light)
    _plot(axes, lift, [(lift.truth, TRUTH, _DASHED), (estimate, ESTIMATE, _SOLID)], until_s)
    for times, angles in before_lift(lift):
        known = (times <= until_s) & (angles >= low) & (angles <= high)
        axes.plot(times[known], angles[known], color=ESTIMATE.light, linewidth=0.8, alpha=0.7)
    onsets = (lift.onset_truth_s, TRUTH, (4, 2)), (lift.onset_estimate_s, ESTIMATE, (1, 1))
    for onset, colour, dashes in onsets:
        if onset is not None and onset <= until_s:
            axes.axvline(onset, color=colour.light, linewidth=1.2, linestyle=(0, dashes), zorder=1)
    bottom = axes
    if tips:
        height = figure.get_size_inches()[1] * PX_PER_INCH
        bottom = placed(figure, _LEFT_PX, height - _BOTTOM_PX - states_px + 3.0, _RIGHT_PX, _BOTTOM_PX)
        bottom.set_xlim(axes.get_xlim())
        axes.tick_params(labelbottom=False)
        _draw_states(bottom, tips, until_s)
    bottom.set_xlabel(lift.time_label, labelpad=1.0)
    return axes


def _lift_axes(
    figure: Figure, lift: LiftCurves, time_s: Range, angle_deg: Range, below_px: float = 0.0
) -> Axes:
    """Return axes with the phases of a lift; below_px: additional margin at the bottom."""
    axes = placed(figure, _LEFT_PX, _TOP_PX, _RIGHT_PX, _BOTTOM_PX + below_px)
    axes.set(xlim=time_s, ylim=angle_deg)
    axes.set_ylabel("angle, degrees")
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    start, end = shown_range(lift)
    borders = {name: t for name, t in lift.phases_s.items() if name in ("A", "B", "C", "lower")}
    for name, begins in borders.items():
        ends = min((t for t in borders.values() if t > begins), default=end)
        if name == "lower" or ends <= start:
            continue
        if name == "B":
            axes.axvspan(begins, ends, color=PHASE.light, linewidth=0, zorder=0)
        axes.text(
            (max(begins, start) + min(ends, end)) / 2, 1.0, name, transform=axes.get_xaxis_transform(),
            ha="center", va="bottom", fontsize=10.5, color=MUTED.light,
        )  # fmt: skip
    return axes


def _plot(
    axes: Axes, lift: LiftCurves, curves: Iterable[tuple[Angles, Colour, Range]], until_s: float = np.inf
) -> None:
    """Draw curves in the shown range of a lift, each with its colour and dashes."""
    for curve, colour, dashes in curves:
        shown = _shown(lift, curve, until_s)
        axes.plot(curve.time_s[shown], curve.angle_deg[shown], color=colour.light, dashes=dashes)


def _shown(lift: LiftCurves, curve: Angles, until_s: float) -> np.ndarray:
    start, end = shown_range(lift)
    return (curve.time_s >= start) & (curve.time_s <= min(until_s, end))


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
                )  # fmt: skip
    axes.set_ylim(0, len(tips))
    axes.set_yticks([])
    axes.grid(False)
    axes.spines["left"].set_visible(False)


def shown_range(lift: LiftCurves) -> Range:
    """Return the time range of a lift's chart, s: from the start of A to the end of C."""
    if lift.axes is not None:
        return lift.axes[0]
    if not lift.phases_s:
        times = np.concatenate([lift.estimate.time_s, lift.truth.time_s])
        start = float(times.min()) if times.size else 0.0
        return start, max(float(times.max(initial=start)), start + _SHORTEST_S)
    begins = lift.phases_s.get("A", lift.phases_s.get("B", 0.0) - 1.0)
    curves = (lift.truth, lift.estimate, *lift.tips.values())
    ends = max(float(curve.time_s.max(initial=begins)) for curve in curves)
    return begins, lift.phases_s.get("lower", ends) + _AFTER_S


def angle_range(lift: LiftCurves) -> Range:
    """Return the range of the angle axis of a lift's chart, deg."""
    if lift.axes is not None:
        return lift.axes[1]
    values = [c.angle_deg[_shown(lift, c, np.inf)] for c in (lift.estimate, lift.truth)]
    values += [np.percentile(angles, _MOST_BEFORE) for _, angles in before_lift(lift)]
    low, high = limits(*values, room=0.08, least=0.1)
    missing = max(_LEAST_SPAN_DEG - (high - low), 0.0) / 2
    return low - missing, high + missing


def before_lift(lift: LiftCurves) -> list[tuple[Floats, Floats]]:
    """Return each fingertip's angles in phase A, s and deg; angles are fused only from the lift on."""
    if "A" not in lift.phases_s or "B" not in lift.phases_s:
        return []
    found = []
    for answered in (tip.known for tip in lift.tips.values()):
        inside = (answered.time_s >= lift.phases_s["A"]) & (answered.time_s < lift.phases_s["B"])
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


def draw_panel(lift: LiftCurves, width_px: int, height_px: int) -> CurvePanel:
    (whole, origin, one), (empty, *_) = (
        _drawn(lift, width_px, height_px, until_s) for until_s in (np.inf, -np.inf)
    )
    return CurvePanel(whole, empty, origin, one - origin)


def _drawn(lift: LiftCurves, width_px: int, height_px: int, until_s: float) -> tuple[Image, float, float]:
    """Return the image, and the columns of the times 0 s and 1 s."""
    with drawing(height_px / _FILM_SCALE, width_px / _FILM_SCALE, arranged=False) as figure:
        figure.set_dpi(PX_PER_INCH * _FILM_SCALE)
        figure.set_facecolor(PAPER.light)
        axes = draw_lift(figure, lift, until_s)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        zero, one = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0]
        return np.asarray(canvas.buffer_rgba())[..., :3].copy(), float(zero), float(one)
