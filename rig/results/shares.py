"""Shares of a number of samples, with their confidence interval: the one way in which they are printed."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

FEWEST = 5
"""Smallest number of samples with a percentage and an interval."""
NORMAL_95 = 1.959964
"""Two-sided 95 % quantile of the standard normal distribution."""


@dataclass(frozen=True, slots=True)
class Share:
    """A number of samples that have a property, of all samples, at least one.

    low, high: ends of the 95 % interval of the fraction (Wilson), which assumes independent samples; None
    below `FEWEST` samples.
    """

    count: int
    of: int
    low: float | None
    high: float | None

    def __float__(self) -> float:
        return self.count / self.of

    def __str__(self) -> str:
        """Return "79% [71, 85]", or "3 of 4" below `FEWEST` samples."""
        if self.low is None or self.high is None:
            return f"{self.count} of {self.of}"
        return f"{float(self):.0%} [{100 * self.low:.0f}, {100 * self.high:.0f}]"


def share_of(has: Iterable[bool]) -> Share | None:
    """Return the share of samples that have a property; None without samples."""
    values = [bool(value) for value in has]
    count, of = sum(values), len(values)
    low, high = wilson(count, of) if of >= FEWEST else (None, None)
    return Share(count, of, low, high) if of else None


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return the ends of Wilson's 95 % interval of a fraction. of: at least one sample."""
    square = NORMAL_95**2 / of
    middle, half = (
        count / of + square / 2.0,
        math.sqrt(count / of * (1.0 - count / of) * square + square**2 / 4.0),
    )
    return max(0.0, (middle - half) / (1.0 + square)), min(1.0, (middle + half) / (1.0 + square))
