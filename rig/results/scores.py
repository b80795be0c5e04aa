"""Compute the errors of the estimated angles of one lift or clip."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.results.metrics import ErrorSummary, Floats, hold_last, summarize

WRONG_DEG, WRONG_SIGMAS = 10.0, 3.0
"""An answer is confidently wrong if its error exceeds both: degrees, and multiples of its sigma."""


class TimedAngle(Protocol):
    """An angle at a time."""

    @property
    def time_ns(self) -> int:
        """Time of the frame."""
        ...

    @property
    def angle_deg(self) -> float | None:
        """Angle; None if the frame was refused."""
        ...

    @property
    def sigma_deg(self) -> float | None:
        """Standard deviation of the angle; None if the method has none."""
        ...


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


def score_angles(
    key: str, angles: Sequence[TimedAngle], true_deg: Sequence[float | None], hold_ns: int
) -> SeriesScore:
    """Score the angles of phases B and C of a lift as `score_series` does. hold_ns: end of phase B."""
    in_b = np.array([angle.time_ns < hold_ns for angle in angles], bool)
    return score_series(key, [a.angle_deg for a in angles], [a.sigma_deg for a in angles], true_deg, in_b)


def score_series(
    key: str,
    angles_deg: Sequence[float | None],
    sigmas_deg: Sequence[float | None],
    true_deg: Sequence[float | None],
    in_b: NDArray[np.bool_] | None = None,
) -> SeriesScore:
    """Compare angles (N), None if refused, with the ground truth (N), None if unknown, in degrees.

    in_b: (N), whether a frame is in phase B; None if all are.
    """
    angles, truth, sigmas = _floats(angles_deg), _floats(true_deg), _floats(sigmas_deg)
    errors = np.abs(angles - truth)
    sure = np.isfinite(errors) & np.isfinite(sigmas)
    return SeriesScore(
        key=key,
        re=_summary(errors),
        re_b=_summary(errors if in_b is None else errors[in_b]),
        re_held=_summary(np.abs(hold_last(angles_deg) - truth)),
        re_unsigned=_summary(np.abs(np.abs(angles) - np.abs(truth))),
        frames=len(angles),
        answered=float(np.isfinite(angles).mean()) if len(angles) else 0.0,
        sure=int(sure.sum()),
        within=int((errors[sure] <= 2.0 * sigmas[sure]).sum()),
        wrong=int(sum(map(is_confidently_wrong, errors[sure], sigmas[sure]))),
    )


def _floats(values: Sequence[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _summary(errors_deg: Floats) -> ErrorSummary | None:
    return summarize(errors_deg[np.isfinite(errors_deg)])
