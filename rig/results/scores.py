"""Compute the errors of the estimated angles of one lift or clip; unwrap angles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import plural
from rig.results.metrics import ErrorSummary, Floats, hold_last, summarize
from rig.tactile.angles import Angles
from rig.tactile.slip.parameters import MOST_RATE_RAD_S

Values = Floats | Sequence[float | None]
WRONG_DEG, WRONG_SIGMAS = 10.0, 3.0
"""An answer is confidently wrong if its error exceeds both: degrees, and multiples of its sigma."""


@dataclass(frozen=True, slots=True)
class SeriesScore:
    """The errors of one estimator on one lift or clip, in degrees; None if there is no angle.

    key: name of the lift or clip. re: over all frames (phases B and C of a lift). re_b: over phase B.
    re_held: with refused frames held at the last angle. re_unsigned: of the absolute angle. frames: number of
    frames. answered: fraction of frames with an angle. sure: number of frames with an angle, a sigma and
    ground truth. within: number of those whose error is at most two sigma. wrong: number of those that are
    confidently wrong.

    Onsets of slip are in s since the start of the lift, None without an onset. onset_truth_s: of the ground
    truth. onset_estimate_s: found afterwards in the estimate. onset_event_s: reported during the lift; this
    needs an estimator that reports rates (has_rates).
    """

    key: str
    re: ErrorSummary | None
    re_b: ErrorSummary | None
    re_held: ErrorSummary | None
    re_unsigned: ErrorSummary | None
    frames: int
    answered: float
    sure: int
    within: int
    wrong: int
    onset_truth_s: float | None = None
    onset_estimate_s: float | None = None
    onset_event_s: float | None = None
    has_rates: bool = False


def is_confidently_wrong(error_deg: float, sigma_deg: float | None) -> bool:
    """Return whether an error is larger than 10 degrees and larger than 3 sigma.

    error_deg: with either sign. sigma_deg: standard deviation of the angle; if it is None, the angle is never
    confidently wrong.
    """
    return sigma_deg is not None and abs(error_deg) > max(WRONG_DEG, WRONG_SIGMAS * sigma_deg)


def score_angles(key: str, angles: Angles, true_deg: Floats, hold_ns: int) -> SeriesScore:
    """Score the angles of phases B and C of a lift as `score_series` does. hold_ns: end of phase B."""
    return score_series(key, angles.angle_deg, angles.sigma_deg, true_deg, angles.time_ns < hold_ns)


def score_series(
    key: str,
    angles_deg: Values,
    sigmas_deg: Values,
    true_deg: Values,
    in_b: NDArray[np.bool_] | None = None,
) -> SeriesScore:
    """Compare angles (N) with the ground truth (N), in degrees; NaN or None if refused or unknown.

    in_b: (N), whether a frame is in phase B; None if all are.
    """
    angles, truth, sigmas = (np.array(v, np.float64) for v in (angles_deg, true_deg, sigmas_deg))
    errors = np.abs(angles - truth)
    sure = np.isfinite(errors) & np.isfinite(sigmas)
    return SeriesScore(
        key=key,
        re=_summary(errors),
        re_b=_summary(errors if in_b is None else errors[in_b]),
        re_held=_summary(np.abs(hold_last(angles) - truth)),
        re_unsigned=_summary(np.abs(np.abs(angles) - np.abs(truth))),
        frames=len(angles),
        answered=float(np.isfinite(angles).mean()) if len(angles) else 0.0,
        sure=int(sure.sum()),
        within=int((errors[sure] <= 2.0 * sigmas[sure]).sum()),
        wrong=int(sum(map(is_confidently_wrong, errors[sure], sigmas[sure]))),
    )


def _summary(errors_deg: Floats) -> ErrorSummary | None:
    return summarize(errors_deg[np.isfinite(errors_deg)])


AXIS_DEG, TURN_DEG = 180.0, 360.0
"""Periods of the angle of an axis and of a direction. An object does not turn by half a period in a frame."""
_MOST_RATE_DEG_S = math.degrees(MOST_RATE_RAD_S)


def unwrap(what: str, angles: Angles, period_deg: float) -> tuple[Angles, tuple[str, ...]]:
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
            many, first = plural(int(which.sum()), "step"), times_s[1:][which][0]
            notes.append(f"{what} {verb}{many} of more than {least:g} degrees (first at {first:.3f} s){end}")
    return replace(angles, angle_deg=angle_deg), tuple(notes)
