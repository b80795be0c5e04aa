"""Rotational error of lifts and trials: the paper's RE and MARE (contract, metrics)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.sessions.records import ErrorSummary

Floats = NDArray[np.float64]
BOOTSTRAP_RESAMPLES = 4000
_AT_ONCE = 200
"""Resamples in one array; a divisor of them all."""


@dataclass(frozen=True, slots=True)
class Mare:
    """Mean absolute rotational error over lifts, deg.

    std_deg is the mean over lifts of each lift's standard deviation (the paper's +-), low_deg
    and high_deg the 95 % bootstrap interval of the mean over lifts (None below two lifts).
    """

    mean_deg: float
    std_deg: float
    low_deg: float | None
    high_deg: float | None
    lifts: int

    @property
    def interval(self) -> str:
        """The interval as text, "" where there is none."""
        return "" if self.low_deg is None else f"[{self.low_deg:.2f}, {self.high_deg:.2f}]"

    @property
    def text(self) -> str:
        """The mean with its spread and interval, in plain characters."""
        return f"{self.mean_deg:.2f} +- {self.std_deg:.2f} {self.interval}".rstrip()


def summarize(errors_deg: Floats) -> ErrorSummary | None:
    """Summarize a lift's absolute errors (N,) in degrees; None when there are none."""
    if errors_deg.size == 0:
        return None
    return ErrorSummary(
        float(errors_deg.mean()), float(errors_deg.std()), float(errors_deg.max()), int(errors_deg.size)
    )


def hold_last(angles_deg: Sequence[float | None]) -> Floats:
    """Fill refused frames with the last answer given (0 before any), so refusing does not pay."""
    held, last = np.empty(len(angles_deg)), 0.0
    for i, angle in enumerate(angles_deg):
        last = last if angle is None else angle
        held[i] = last
    return held


def mare(means_deg: Sequence[float], stds_deg: Sequence[float], seed: int = 0) -> Mare | None:
    """Mean over lifts with its bootstrap interval; None without lifts."""
    if not means_deg:
        return None
    means = np.asarray(means_deg, float)
    low, high = bootstrap_interval(means, seed)
    return Mare(float(means.mean()), float(np.mean(stds_deg)), low, high, len(means))


def bootstrap_interval(values: Floats, seed: int = 0) -> tuple[float | None, float | None]:
    """95 % interval of the mean of (N,) values (percentile bootstrap); None for both below two values."""
    if values.size < 2:
        return None, None
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    # as scipy.stats.bootstrap does it but for rounding; its import alone takes half a second
    rng, portions = np.random.default_rng(seed), BOOTSTRAP_RESAMPLES // _AT_ONCE
    drawn = (rng.integers(0, values.size, (_AT_ONCE, values.size)) for _ in range(portions))
    low, high = np.percentile(np.concatenate([values[i].mean(axis=-1) for i in drawn]), (2.5, 97.5))
    return float(low), float(high)
