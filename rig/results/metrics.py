"""Compute the rotational error of lifts and trials: the paper's RE and MARE."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from drivers.errors import plural
from rig.sessions.records import ErrorSummary
from rig.tactile.angles import Floats

FEWEST_LIFTS = 5
"""Smallest number of lifts for an interval or a verdict. The paper lifts each object five times."""
INTERVAL = "95 % interval of the mean over lifts (Student's t, corrected for skewness)"
"""Legend of intervals on pages; see `mean_interval`."""
HEADING = f"mean ± std [95 % interval: skewness-corrected t, from {FEWEST_LIFTS} lifts on]"
"""Part of the titles of tables."""
USEFUL_SIGMA_DEG = 5.0
"""Largest sigma of a useful angle."""
_EQUAL = 1e-12
"""Values whose range is smaller count as equal; smaller differences have no meaningful skewness."""


@dataclass(frozen=True, slots=True)
class Mare:
    """Mean absolute rotational error (MARE) over lifts, deg.

    std_deg: mean over lifts of each lift's standard deviation (the paper's ±). low_deg, high_deg: ends of the
    95 % interval of the mean over lifts; None below `FEWEST_LIFTS`. lifts: number of lifts with an angle,
    over which the means are taken. refused: number of lifts without any angle.
    """

    mean_deg: float
    std_deg: float
    low_deg: float | None
    high_deg: float | None
    lifts: int
    refused: int = 0

    @property
    def ends_deg(self) -> list[float] | None:
        """The ends of the interval; None without an interval."""
        return None if self.low_deg is None or self.high_deg is None else [self.low_deg, self.high_deg]

    @property
    def interval(self) -> str:
        return "" if self.low_deg is None else f"[{self.low_deg:.2f}, {self.high_deg:.2f}]"

    @property
    def beside(self) -> str:
        """Interval and number of refused lifts as text; "" without both."""
        return f"{self.interval} {over_lifts(self.lifts, self.refused) if self.refused else ''}".strip()

    @property
    def text(self) -> str:
        return f"{self.mean_deg:.2f} ± {self.std_deg:.2f} {self.beside}".rstrip()


def mare_text(value: Mare | None) -> str:
    return "no answer" if value is None else value.text


def over_lifts(lifts: int, refused: int) -> str:
    """Return a text with the number of lifts in a mean and of refused lifts."""
    every = lifts + refused
    return (
        f"over {lifts} of {plural(every, 'lift')}, {refused} refused"
        if refused
        else f"over {plural(lifts, 'lift')}"
    )


def summarize(errors_deg: Floats) -> ErrorSummary | None:
    """Summarize the absolute errors (N,) of a lift in degrees; None if there are none."""
    if errors_deg.size == 0:
        return None
    return ErrorSummary(
        float(errors_deg.mean()), float(errors_deg.std()), float(errors_deg.max()), int(errors_deg.size)
    )


def hold_last(angles_deg: Floats | Sequence[float | None]) -> Floats:
    """Fill refused frames with the last angle (0 before the first), so refusing cannot reduce the error."""
    angles = np.array(angles_deg, np.float64)
    last = np.maximum.accumulate(np.where(np.isfinite(angles), np.arange(angles.size), -1))
    return np.where(last < 0, 0.0, angles[last])


def mare_of(errors: Iterable[ErrorSummary | None]) -> Mare | None:
    """Return the MARE over the errors of lifts, None for a refused lift; None if all are refused."""
    every = list(errors)
    known = [error for error in every if error is not None]
    if not known:
        return None
    means = np.array([error.mean_deg for error in known])
    low, high = mean_interval(means)
    return Mare(
        mean_deg=float(means.mean()),
        std_deg=float(np.mean([error.std_deg for error in known])),
        low_deg=None if low is None else max(low, 0.0),
        high_deg=high,
        lifts=len(known),
        refused=len(every) - len(known),
    )


def mean_interval(values: Floats) -> tuple[float | None, float | None]:
    """Return the ends of the 95 % interval of the mean of (N,) values; None below `FEWEST_LIFTS` values.

    The interval is Student's t interval with a correction. Errors are skewed, because a few lifts have large
    ones, so a t interval ends too early on the side of the long tail. The end on that side is corrected for
    skewness (Hall 1992, J. R. Stat. Soc. B 54, 221-228). The coverage is measured in
    tests/unit/rig/results/test_metrics.py.
    """
    if values.size < FEWEST_LIFTS:
        return None, None
    mean = float(values.mean())
    if np.ptp(values) < _EQUAL:
        return mean, mean
    from scipy.special import stdtrit  # imported here, because the import is slow

    n = values.size
    skewness = float(np.mean(((values - mean) / values.std()) ** 3))
    size = max(abs(skewness), 1e-6)
    near = float(stdtrit(n - 1, 0.975)) / sqrt(n)
    far = 3.0 / size * (1.0 - float(np.cbrt(1.0 - size * (near + size / (6 * n)))))
    below, above = (near, far) if skewness > 0.0 else (far, near)
    spread = float(values.std(ddof=1))
    return mean - below * spread, mean + above * spread
