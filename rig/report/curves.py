"""The angle curves of a lift, whether they come from a recording or from a plain table."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from rig.lift.marker_truth import TruthSeries, interpolate
from rig.results.metrics import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """An angle over time.

    time_s: (N,) float64, increasing. angle_deg, sigma_deg: (N,) float64, NaN if refused or unknown. states:
    (N,) states of the estimator; empty if unknown.
    """

    time_s: Floats
    angle_deg: Floats
    sigma_deg: Floats
    states: tuple[str, ...] = ()

    @property
    def answered(self) -> "Curve":
        """Return the samples with an angle."""
        known = np.isfinite(self.angle_deg)
        states = tuple(s for s, k in zip(self.states, known, strict=True) if k) if self.states else ()
        return Curve(self.time_s[known], self.angle_deg[known], self.sigma_deg[known], states)


@dataclass(frozen=True, slots=True, eq=False)
class LiftCurves:
    """All curves of one lift; times in s from the start of phase B (in a table: as given), angles in deg.

    estimate: the fused angle. truth: the marker angle. tips: the angle of each fingertip, by serial.
    phases_s: start times of phases, "A", "B", "C" and "lower" among them; empty if unknown. onset_truth_s,
    onset_estimate_s: None without a slip. axes: ranges of the chart's axes, s and deg; None: from the
    curves (`on_one_scale`).
    """

    name: str
    estimate: Curve
    truth: Curve
    phases_s: dict[str, float] = field(default_factory=dict)
    onset_truth_s: float | None = None
    onset_estimate_s: float | None = None
    tips: dict[str, Curve] = field(default_factory=dict)
    time_label: str = "time from the start of the lift, s"
    axes: tuple[tuple[float, float], tuple[float, float]] | None = None

    def within(self, *phases: str) -> NDArray[np.bool_]:
        """Return which frames of the estimate, (N,) bool, are in these phases; all if phases are unknown."""
        times = self.estimate.time_s
        inside = np.zeros(times.shape, bool)
        for phase in phases:
            if phase in self.phases_s:
                begins = self.phases_s[phase]
                ends = min((t for t in self.phases_s.values() if t > begins), default=np.inf)
                inside |= (times >= begins) & (times < ends)
        return inside if self.phases_s else np.ones(times.shape, bool)


AXIS_DEG, TURN_DEG = 180.0, 360.0
"""Periods of the angle of an axis and of a direction. An object does not turn by half a period in a frame."""


def unwrapped(what: str, curve: Curve, period_deg: float) -> tuple[Curve, tuple[str, ...]]:
    """Return a curve without the steps of a wrapped angle, and a note if there were any.

    what: name of the angle, for the note. period_deg: steps of more than half of it, or for `TURN_DEG` three
    quarters, are reduced by multiples of it; an estimate may have true errors of half a turn.
    """
    known = np.flatnonzero(np.isfinite(curve.angle_deg))
    steps = np.diff(curve.angle_deg[known])
    least = 0.5 * AXIS_DEG if period_deg == AXIS_DEG else 0.75 * TURN_DEG
    turns = np.where(np.abs(steps) > least, np.rint(steps / period_deg), 0.0)
    if not turns.any():
        return curve, ()
    angle_deg = curve.angle_deg.copy()
    angle_deg[known[1:]] -= period_deg * np.cumsum(turns)
    first = curve.time_s[known[1:]][turns != 0.0][0]
    note = (
        f"{what} is wrapped: {int((turns != 0.0).sum())} steps of more than {least:g} degrees (first at "
        f"{first:.3f} s), unwrapped"
    )
    return Curve(curve.time_s, angle_deg, curve.sigma_deg, curve.states), (note,)


def truth_at(truth: Curve, time_s: Floats) -> Floats:
    """Return the marker angle at other times, (N,) deg; NaN in gaps of more than 50 ms."""
    known = truth.answered
    times_ns = np.rint(known.time_s * NS_PER_S).astype(np.int64)
    series = TruthSeries(times_ns, known.angle_deg, known.sigma_deg, 0.0, None, {})
    found = [interpolate(series, int(t)) for t in np.rint(time_s * NS_PER_S)]
    return np.array([np.nan if angle is None else angle for angle in found], float)


def signed_errors(lift: LiftCurves) -> Floats:
    """Return estimate minus truth at each frame of the estimate, (N,) deg, NaN if either is missing."""
    return lift.estimate.angle_deg - truth_at(lift.truth, lift.estimate.time_s)


def rates_deg_s(lift: LiftCurves, span_s: float = 0.1) -> Floats:
    """Return the rate of the markers at each frame of the estimate, (N,) deg/s, over `span_s` around it."""
    times = lift.estimate.time_s
    return (truth_at(lift.truth, times + span_s / 2) - truth_at(lift.truth, times - span_s / 2)) / span_s
