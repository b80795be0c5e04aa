"""Angle curves of lifts: wrapped angles, errors and rates."""

from dataclasses import replace

import numpy as np

from rig.sessions.lift_curves import LiftCurves
from rig.tactile.angles import Angles, Floats

AXIS_DEG, TURN_DEG = 180.0, 360.0
"""Periods of the angle of an axis and of a direction. An object does not turn by half a period in a frame."""


def unwrapped(what: str, angles: Angles, period_deg: float) -> tuple[Angles, tuple[str, ...]]:
    """Return angles without the steps of a wrapped angle, and a note if there were any.

    what: name of the angle, for the note. period_deg: steps of more than half of it, or for `TURN_DEG` three
    quarters, are reduced by multiples of it; an estimate may have true errors of half a turn.
    """
    known = np.flatnonzero(np.isfinite(angles.angle_deg))
    steps = np.diff(angles.angle_deg[known])
    least = 0.5 * AXIS_DEG if period_deg == AXIS_DEG else 0.75 * TURN_DEG
    turns = np.where(np.abs(steps) > least, np.rint(steps / period_deg), 0.0)
    if not turns.any():
        return angles, ()
    angle_deg = angles.angle_deg.copy()
    angle_deg[known[1:]] -= period_deg * np.cumsum(turns)
    first = angles.time_s[known[1:]][turns != 0.0][0]
    note = (
        f"{what} is wrapped: {int((turns != 0.0).sum())} steps of more than {least:g} degrees (first at "
        f"{first:.3f} s), unwrapped"
    )
    return replace(angles, angle_deg=angle_deg), (note,)


def signed_errors(lift: LiftCurves) -> Floats:
    """Return estimate minus truth at each frame of the estimate, (N,) deg, NaN if either is missing."""
    return lift.estimate.angle_deg - lift.truth.at(lift.estimate.time_s)


def rates_deg_s(lift: LiftCurves, span_s: float = 0.1) -> Floats:
    """Return the rate of the markers at each frame of the estimate, (N,) deg/s, over `span_s` around it."""
    times = lift.estimate.time_s
    return (lift.truth.at(times + span_s / 2) - lift.truth.at(times - span_s / 2)) / span_s
