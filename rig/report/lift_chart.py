"""The chart of one lift over time, and the growing curve of a film."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivers.types import Image
from rig.pages.figure import PX_PER_INCH, WIDTH_PX, band, drawing, limits, placed
from rig.pages.palette import ESTIMATE, FIRST, INK, MUTED, PAPER, PHASE, SECOND, STATES, TRUTH
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
_SHADED, _PLAIN = "B", ("A", "C")
_AFTER_S = 0.15
_MOST_BEFORE = (5.0, 95.0)
"""Percentiles of the angles in phase A that the axes include; angles of first contacts can be arbitrary."""


def lift_chart(
    lift: LiftCurves, caption: str, width_px: float = WIDTH_PX, height_px: float = HEIGHT_PX
) -> Chart:
    """Draw a lift."""
    with drawing(height_px, width_px, arranged=False) as figure:
        draw_lift(figure, lift)
        what = "estimated and marker angle" if lift.truth.time_s.size else "estimated angle"
        return Chart(lift.name, figure, caption, f"{lift.name}: {what} over time")


def pair_chart(first: LiftCurves, second: LiftCurves, caption: str) -> Chart:
    """Draw one lift with the estimates of both sides of a comparison, and the marker angle of each."""
    with drawing(HEIGHT_PX, arranged=False) as figure:
        axes = placed(figure, _LEFT_PX, _TOP_PX, _RIGHT_PX, _BOTTOM_PX)
        time_s, angle_deg = _common_axes([replace(lift, tips={}) for lift in (first, second)])
        axes.set(xlim=time_s, ylim=angle_deg)
        _phases(axes, first)
        same = np.array_equal(first.truth.angle_deg, second.truth.angle_deg, equal_nan=True)
        drawn = [(first, first.truth, TRUTH, (4.0, 1.2)), (first, first.estimate, FIRST, (1.0, 0.0))]
        drawn += [] if same else [(second, second.truth, TRUTH, (1.2, 1.2))]
        drawn += [(second, second.estimate, SECOND, (1.0, 0.0))]
        for lift, curve, colour, dashes in drawn:
            start, end = shown_range(lift)
            shown = (curve.time_s >= start) & (curve.time_s <= end)
            axes.plot(curve.time_s[shown], curve.angle_deg[shown], color=colour.light, dashes=dashes)
        axes.set_ylabel("angle, degrees")
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axes.set_xlabel(first.time_label, labelpad=1.0)
        return Chart(first.name, figure, caption, f"{first.name}: both estimates and the marker angle")


def on_one_scale(lifts: Sequence[LiftCurves]) -> list[LiftCurves]:
    """Return the lifts with common axes, for charts that are compared with each other."""
    axes = _common_axes(lifts)
    return [replace(lift, axes=axes) for lift in lifts]


def _common_axes(lifts: Sequence[LiftCurves]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the smallest ranges that include all charts, s and deg."""
    times = [shown_range(lift) for lift in lifts]
    angles = [angle_range(lift) for lift in lifts]
    return (
        (min(start for start, _ in times), max(end for _, end in times)),
        (min(low for low, _ in angles), max(high for _, high in angles)),
    )


def draw_lift(figure: Figure, lift: LiftCurves, until_s: float = np.inf) -> Axes:
    """Draw a lift's angles and, below them, the states, up to the time `until_s`."""
    tips = [tip for tip in lift.tips.values() if tip.states]
    states_px = _STATE_PX * len(tips)
    axes = placed(figure, _LEFT_PX, _TOP_PX, _RIGHT_PX, _BOTTOM_PX + states_px)
    _phases(axes, lift)
    _curves(axes, lift, until_s)
    _onsets(axes, lift, until_s)
    axes.set_ylabel("angle, degrees")
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    bottom = axes
    if tips:
        height = figure.get_size_inches()[1] * PX_PER_INCH
        bottom = placed(figure, _LEFT_PX, height - _BOTTOM_PX - states_px + 3.0, _RIGHT_PX, _BOTTOM_PX)
        bottom.set_xlim(axes.get_xlim())
        axes.tick_params(labelbottom=False)
        draw_states(bottom, tips, until_s)
    bottom.set_xlabel(lift.time_label, labelpad=1.0)
    return axes


def draw_states(axes: Axes, tips: list[Angles], until_s: float = np.inf) -> None:
    """Draw the states of each fingertip's estimator, one coloured line per fingertip."""
    for row, tip in enumerate(tips):
        for begins, ends, state in runs(tip):
            if begins >= until_s:
                break
            axes.broken_barh(
                [(begins, min(ends, until_s) - begins)], (len(tips) - row - 0.9, 0.8),
                facecolors=STATES[state].light if state in STATES else MUTED.light, linewidth=0,
            )  # fmt: skip
    axes.set_ylim(0, len(tips))
    axes.set_yticks([])
    axes.grid(False)
    axes.spines["left"].set_visible(False)


def runs(curve: Angles) -> list[tuple[float, float, str]]:
    """Return runs of equal state: start and end in s, and the state."""
    found: list[tuple[float, float, str]] = []
    for time_s, state in zip(curve.time_s.tolist(), curve.states, strict=True):
        if found and found[-1][2] == state:
            found[-1] = (found[-1][0], time_s, state)
        else:
            if found:
                found[-1] = (found[-1][0], time_s, found[-1][2])
            found.append((time_s, time_s, state))
    return found


def shown_range(lift: LiftCurves) -> tuple[float, float]:
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


def angle_range(lift: LiftCurves) -> tuple[float, float]:
    """Return the range of the angle axis of a lift's chart, deg."""
    if lift.axes is not None:
        return lift.axes[1]
    start, end = shown_range(lift)
    values = []
    for curve in (lift.estimate, lift.truth):
        values.append(curve.angle_deg[(curve.time_s >= start) & (curve.time_s <= end)])
    for _, angles in before_lift(lift):
        values.append(np.percentile(angles, _MOST_BEFORE))
    low, high = limits(*values, room=0.08, least=0.1)
    missing = max(_LEAST_SPAN_DEG - (high - low), 0.0) / 2
    return low - missing, high + missing


def before_lift(lift: LiftCurves) -> list[tuple[Floats, Floats]]:
    """Return each fingertip's angles in phase A, s and deg; angles are fused only from the lift on."""
    if "A" not in lift.phases_s or "B" not in lift.phases_s:
        return []
    found = []
    for tip in lift.tips.values():
        answered = tip.known
        inside = (answered.time_s >= lift.phases_s["A"]) & (answered.time_s < lift.phases_s["B"])
        if inside.any():
            found.append((answered.time_s[inside], answered.angle_deg[inside]))
    return found


def _curves(axes: Axes, lift: LiftCurves, until_s: float) -> None:
    start, end = shown_range(lift)
    axes.set_xlim(start, end)
    axes.set_ylim(*angle_range(lift))
    for curve, colour, dashes in ((lift.truth, TRUTH, (4.0, 1.2)), (lift.estimate, ESTIMATE, (1.0, 0.0))):
        known = (curve.time_s >= start) & (curve.time_s <= min(until_s, end))
        times, angles = curve.time_s[known], curve.angle_deg[known]
        spread = SIGMAS * curve.sigma_deg[known]
        if curve is lift.estimate and np.isfinite(spread).any():
            band(axes, times, angles, spread, colour.light)
        axes.plot(times, angles, color=colour.light, dashes=dashes)
    low, high = axes.get_ylim()
    for times, angles in before_lift(lift):
        known = (times <= until_s) & (angles >= low) & (angles <= high)
        axes.plot(times[known], angles[known], color=ESTIMATE.light, linewidth=0.8, alpha=0.7)


def _phases(axes: Axes, lift: LiftCurves) -> None:
    start, end = shown_range(lift)
    borders = {n: t for n, t in lift.phases_s.items() if n in (*_PLAIN, _SHADED, "lower")}
    for name, begins in borders.items():
        ends = min((t for t in borders.values() if t > begins), default=end)
        if name == "lower" or ends <= start:
            continue
        if name == _SHADED:
            axes.axvspan(begins, ends, color=PHASE.light, linewidth=0, zorder=0)
        middle = (max(begins, start) + min(ends, end)) / 2
        axes.text(
            middle, 1.0, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom",
            fontsize=10.5, color=MUTED.light,
        )  # fmt: skip


def _onsets(axes: Axes, lift: LiftCurves, until_s: float) -> None:
    for onset, colour, style in (
        (lift.onset_truth_s, TRUTH, (0, (4, 2))),
        (lift.onset_estimate_s, ESTIMATE, (0, (1, 1))),
    ):
        if onset is not None and onset <= until_s:
            axes.axvline(onset, color=colour.light, linewidth=1.2, linestyle=style, zorder=1)


def key(states: bool = True, truth: bool = True) -> list[dict[str, str]]:
    """Return the legend of all lift charts. truth: with ground truth and phases, as in a trial."""
    lines = [
        {"kind": "line", "colour": ESTIMATE.css, "text": f"estimated angle, with its {SIGMAS:g} sigma band"},
        {"kind": "dash", "colour": TRUTH.css, "text": "marker angle"},
        {
            "kind": "line",
            "colour": ESTIMATE.css,
            "text": "thin: each fingertip's angle in phase A, before the lift",
        },
        {"kind": "fill", "colour": PHASE.css, "text": "phase B: the arm lifts"},
        {
            "kind": "dash",
            "colour": INK.css,
            "text": "vertical: where the slip begins, in the colour of the curve that shows it",
        },
    ]
    claims = [
        {"kind": "fill", "colour": colour.css, "text": name.replace("_", " ")}
        for name, colour in STATES.items()
    ]
    if not truth:
        lines = [lines[0], lines[-1]]
    return [*lines, *claims] if states else lines


_SCALE = 1.25
"""Scale relative to a chart on a page, because films are watched from a larger distance."""


@dataclass(frozen=True, slots=True, eq=False)
class CurvePanel:
    """Images, (H, W, 3) uint8 RGB, of a lift's curves with their axes, and of the axes without curves.

    The time t, in s, is at column `origin_px + t * px_per_s`.
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
        picture[_TOP:-_BOTTOM, column] = rgb(INK.light)
        return picture


_TOP, _BOTTOM = 22, 46
"""Distances of the ends of the time line from the panel's edges, px: at the axes."""


def draw_panel(lift: LiftCurves, width_px: int, height_px: int) -> CurvePanel:
    """Draw a lift's curves at a size in px."""
    whole, origin, per_s = _drawn(lift, width_px, height_px, np.inf)
    axes, _, _ = _drawn(lift, width_px, height_px, -np.inf)
    return CurvePanel(whole, axes, origin, per_s)


def _drawn(lift: LiftCurves, width_px: int, height_px: int, until_s: float) -> tuple[Image, float, float]:
    with drawing(height_px / _SCALE, width_px / _SCALE, arranged=False) as figure:
        figure.set_dpi(PX_PER_INCH * _SCALE)
        figure.set_facecolor(PAPER.light)
        axes = draw_lift(figure, lift, until_s)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        zero, one = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0]
        return picture, float(zero), float(one - zero)
