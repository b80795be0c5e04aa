"""Finger opening over gripper counts: a measured, monotone table for each direction, never extrapolated.

The Robotiq manual calls the relation nonlinear and approximate, and its ends are software limits; a
straight line through it is wrong by millimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from calibration.verdict import Assessment, Rejected, floor, limit, sift
from drivers.errors import CalibrationError, counted

Array = NDArray[np.floating]

MOST_COUNTS = 255
FEWEST_COUNTS = 3


class Direction(StrEnum):
    """Direction in which the fingers moved before the measurement."""

    CLOSING = "closing"
    OPENING = "opening"


@dataclass(frozen=True, slots=True)
class OpeningSample:
    """A measured opening in m at the counts the gripper reported, and the direction of the motion before."""

    id: str
    counts: float
    opening_m: float
    direction: Direction


@dataclass(frozen=True, slots=True, eq=False)
class OpeningTable:
    """counts (N,) increasing, opening_m (N,) not increasing, sigma_m (N,), for one direction."""

    counts: Array
    opening_m: Array
    sigma_m: Array

    def opening_at(self, counts: float) -> float:
        """Opening in m at a count. Raises `CalibrationError` beyond what was measured."""
        if not self.counts[0] <= counts <= self.counts[-1]:
            raise CalibrationError(
                f"gripper table: {counts:.4g} counts lie beyond what was measured "
                f"({self.counts[0]:.4g} to {self.counts[-1]:.4g}); measure there with rig calibrate gripper"
            )
        return float(np.interp(counts, self.counts, self.opening_m))


@dataclass(frozen=True, slots=True, eq=False)
class GripperResult:
    """What was fitted.

    Tables by direction; hysteresis_m: largest difference between them where both were measured;
    misfit_m: rms by which measurements miss their table; both None where unknown.
    """

    assessment: Assessment
    tables: dict[Direction, OpeningTable]
    rejected: tuple[Rejected, ...]
    hysteresis_m: float | None = None
    misfit_m: float | None = None


def calibrate_opening(samples: Sequence[OpeningSample]) -> GripperResult:
    """Fit a monotone table for each direction that was measured; the other stays unknown."""
    good, rejected = sift(samples, lambda sample: sample.id, lambda sample, _: _fault(sample))
    tables, missed = {}, []
    for direction in Direction:
        chosen = [s for s in good if s.direction is direction]
        if len({s.counts for s in chosen}) >= FEWEST_COUNTS:
            tables[direction], rest = _table(chosen)
            missed.append(rest)
    if not tables:
        text = (
            f"{counted(len(good), 'usable measurement')}; at least {FEWEST_COUNTS} different counts one way "
            "are needed"
        )
        return GripperResult(Assessment((text,)), {}, tuple(rejected))
    misfit = float(np.sqrt((np.concatenate(missed) ** 2).mean()))
    hysteresis = _hysteresis(tables)
    assessment = limit(
        1e3 * misfit, 0.3, 2.0, "measurements miss a monotone table by {value:.2f} mm: measure again"
    )
    assessment += floor(
        min(len(t.counts) for t in tables.values()), 6, 3, "{value} counts measured; 8 are good"
    )
    if len(tables) < 2:
        assessment += Assessment(doubts=(f"only {next(iter(tables))} was measured: hysteresis is unknown",))
    else:
        assessment += limit(
            1e3 * (hysteresis or 0.0), 1.0, np.inf, "closing and opening differ by {value:.1f} mm"
        )
    return GripperResult(
        assessment, {} if assessment.refusals else tables, tuple(rejected), hysteresis, misfit
    )


def _table(samples: list[OpeningSample]) -> tuple[OpeningTable, Array]:
    """Isotonic regression over the mean at each count, and what each measurement misses, m."""
    counts = np.array([s.counts for s in samples], np.float64)
    openings = np.array([s.opening_m for s in samples])
    places, where, repeats = np.unique(counts, return_inverse=True, return_counts=True)
    means = np.bincount(where, openings) / repeats
    fitted = np.asarray(isotonic_regression(means, weights=repeats, increasing=False).x)
    missed = openings - fitted[where]
    noise = float(np.sqrt((missed**2).sum() / max(len(missed) - 2, 1)))
    return OpeningTable(places, fitted, np.maximum(noise, 1e-5) / np.sqrt(repeats)), missed


def _hysteresis(tables: dict[Direction, OpeningTable]) -> float | None:
    if len(tables) < 2:
        return None
    one, other = tables[Direction.CLOSING], tables[Direction.OPENING]
    low, high = max(one.counts[0], other.counts[0]), min(one.counts[-1], other.counts[-1])
    at = np.union1d(one.counts, other.counts)
    at = at[(at >= low) & (at <= high)]
    if len(at) == 0:
        return None
    return float(
        np.abs(np.interp(at, one.counts, one.opening_m) - np.interp(at, other.counts, other.opening_m)).max()
    )


def _fault(sample: OpeningSample) -> str | None:
    if not (np.isfinite(sample.counts) and np.isfinite(sample.opening_m)):
        return "a number is not finite"
    if not 0 <= sample.counts <= MOST_COUNTS:
        return f"{sample.counts:g} counts; the gripper counts 0 to {MOST_COUNTS}"
    if not 0.0 <= sample.opening_m < 0.2:
        return f"an opening of {sample.opening_m:g} m; is it given in mm?"
    return None
