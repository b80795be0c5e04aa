"""Remove the steps of wrapped angles."""

import math
from dataclasses import replace

import numpy as np

from drivers.errors import counted
from rig.tactile.angles import Angles
from rig.tactile.slip.parameters import MOST_RATE_RAD_S

AXIS_DEG, TURN_DEG = 180.0, 360.0
"""Periods of the angle of an axis and of a direction. An object does not turn by half a period in a frame."""
_MOST_RATE_DEG_S = math.degrees(MOST_RATE_RAD_S)


def unwrapped(what: str, angles: Angles, period_deg: float) -> tuple[Angles, tuple[str, ...]]:
    """Return angles without the steps of a wrapped angle, and notes on large steps.

    what: name of the angle, for the notes. period_deg: steps of more than half of it, or for `TURN_DEG` three
    quarters, are reduced by multiples of it; an estimate may have true errors of half a turn. A step that an
    object at `MOST_RATE_RAD_S` can turn between its two samples may be a rotation: it is kept.
    """
    known = np.flatnonzero(np.isfinite(angles.angle_deg))
    steps, times_s = np.diff(angles.angle_deg[known]), angles.time_s[known]
    least = 0.5 * AXIS_DEG if period_deg == AXIS_DEG else 0.75 * TURN_DEG
    large = np.abs(steps) > least
    possible = large & (np.abs(steps) <= _MOST_RATE_DEG_S * np.diff(times_s))
    wrapped = large & ~possible
    angle_deg = angles.angle_deg.copy()
    angle_deg[known[1:]] -= period_deg * np.cumsum(np.where(wrapped, np.rint(steps / period_deg), 0.0))
    notes = []
    for which, verb, end in (
        (wrapped, "is wrapped: ", ", unwrapped"),
        (possible, "may be wrapped: ", f", kept: at {_MOST_RATE_DEG_S:g} deg/s an object can turn so far"),
    ):
        if which.any():
            many, first = counted(int(which.sum()), "step"), times_s[1:][which][0]
            notes.append(f"{what} {verb}{many} of more than {least:g} degrees (first at {first:.3f} s){end}")
    return replace(angles, angle_deg=angle_deg), tuple(notes)
