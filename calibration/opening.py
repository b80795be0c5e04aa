"""Finger opening as a function of gripper counts: a measured, monotone table for each direction.

The Robotiq manual calls the relation nonlinear and approximate, and its ends are software limits; a straight
line is wrong by millimetres. The bench uses the table of closing fingers. The table of opening fingers shows
the difference between both directions (hysteresis).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from calibration.verdict import Assessment, Rejected, floor, length_guess, limit, sift
from drivers.errors import counted

Array = NDArray[np.floating]

MOST_COUNTS = 255
"""Largest position that the gripper reports (one byte)."""
FEWEST_COUNTS = 3
"""Fewest different positions that are needed for a table."""


STEP_M = 0.155 / 249
"""Change of the opening per count: the stroke of a Robotiq 3-Finger, from 6 to 255 counts."""
_OFF = 3.0
"""Openings that change by more or less than those of the gripper, by this factor, have another unit. The
true relation is nonlinear."""
_LEAST_COUNTS = 20
"""Shortest range of counts over which the unit is checked: close to an end, fingers hardly move."""


class Direction(StrEnum):
    """Direction in which the fingers moved before the measurement."""

    CLOSING = "closing"
    OPENING = "opening"


@dataclass(frozen=True, slots=True)
class OpeningSample:
    """A measured opening in m, the gripper's counts, and the direction of the motion before it."""

    id: str
    counts: float
    opening_m: float
    direction: Direction


@dataclass(frozen=True, slots=True, eq=False)
class OpeningTable:
    """counts (N,) increasing, opening_m (N,) not increasing, for one direction."""

    counts: Array
    opening_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class GripperResult:
    """The fitted tables by direction; empty if refused.

    hysteresis_m: largest difference between both tables; None if unknown.
    """

    assessment: Assessment
    tables: dict[Direction, OpeningTable]
    rejected: tuple[Rejected, ...]
    hysteresis_m: float | None = None


def calibrate_opening(samples: Sequence[OpeningSample], step_m: float = STEP_M) -> GripperResult:
    """Fit a monotone table for each measured direction; closing is required, opening is optional.

    step_m: change of this gripper's opening per count. A table with another unit than mm is refused.
    """
    good, rejected = sift(samples, lambda sample: sample.id, lambda sample, _: _fault(sample))
    wrong = _wrong_unit(good if len(good) > len(rejected) else samples, step_m)
    if wrong is not None:
        return GripperResult(Assessment((wrong,)), {}, tuple(rejected))
    tables: dict[Direction, OpeningTable] = {}
    missed: list[Array] = []
    for direction in Direction:
        chosen = [s for s in good if s.direction is direction]
        if len(_distinct([s.counts for s in chosen])) >= FEWEST_COUNTS:
            # isotonic regression over the mean at each count
            openings = np.array([s.opening_m for s in chosen])
            places, where, repeats = np.unique(
                [s.counts for s in chosen], return_inverse=True, return_counts=True
            )
            means = np.bincount(where, openings) / repeats
            fitted = np.asarray(isotonic_regression(means, weights=repeats, increasing=False).x)
            tables[direction] = OpeningTable(places, fitted)
            missed.append(openings - fitted[where])
    if Direction.CLOSING not in tables:
        closing = sum(s.direction is Direction.CLOSING for s in good)
        text = (
            f"{counted(closing, 'usable measurement')} while closing; at least {FEWEST_COUNTS} different "
            "counts are needed"
        )
        return GripperResult(Assessment((text,)), {}, tuple(rejected))
    misfit_m = float(np.sqrt((np.concatenate(missed) ** 2).mean()))
    hysteresis_m = _hysteresis_m(tables)
    assessment = limit(
        1e3 * misfit_m, 0.3, 2.0, "measurements miss a monotone table by {value:.2f} mm: measure again"
    )
    assessment += floor(
        min(len(_distinct(t.counts)) for t in tables.values()), 6, 3, "{value} counts measured; 8 are good"
    )
    if len(tables) < 2:
        assessment += Assessment(doubts=("only closing was measured: hysteresis is unknown",))
    else:
        assessment += limit(
            1e3 * (hysteresis_m or 0.0), 1.0, np.inf, "closing and opening differ by {value:.1f} mm"
        )
    return GripperResult(assessment, {} if assessment.refusals else tables, tuple(rejected), hysteresis_m)


def _distinct(counts: Iterable[float]) -> list[float]:
    """Return the positions that are at least one count apart, in increasing order."""
    found: list[float] = []
    for value in sorted(counts):
        if not found or value - found[-1] >= 1.0:
            found.append(value)
    return found


def _wrong_unit(samples: Sequence[OpeningSample], step_m: float) -> str | None:
    """Return that the openings have another unit, with a guess, or None."""
    pairs = np.array([(s.counts, s.opening_m) for s in samples]).reshape(-1, 2)
    finite = pairs[np.isfinite(pairs).all(axis=1)]
    counts, openings_m = (float(span) for span in np.ptp(finite, axis=0)) if len(finite) else (0.0, 0.0)
    if counts < _LEAST_COUNTS:
        return None
    found_m = openings_m / counts
    if step_m / _OFF <= found_m <= step_m * _OFF:
        return None
    guess = length_guess(found_m, "mm", step_m / _OFF, step_m * _OFF)
    return (
        f"the openings change by {1e3 * found_m:.3g} mm per count, those of the gripper by "
        f"{1e3 * step_m:.2g} mm: opening_mm is not in mm{guess}"
    )


def _hysteresis_m(tables: dict[Direction, OpeningTable]) -> float | None:
    """Return the largest difference between both tables in m; None if their counts do not overlap."""
    if len(tables) < 2:
        return None
    one, other = tables.values()
    at = np.union1d(one.counts, other.counts)
    at = at[(at >= max(one.counts[0], other.counts[0])) & (at <= min(one.counts[-1], other.counts[-1]))]
    gaps = np.interp(at, one.counts, one.opening_m) - np.interp(at, other.counts, other.opening_m)
    return float(np.abs(gaps).max()) if len(at) else None


def _fault(sample: OpeningSample) -> str | None:
    if not (np.isfinite(sample.counts) and np.isfinite(sample.opening_m)):
        return "a value is NaN or infinite"
    if not 0 <= sample.counts <= MOST_COUNTS:
        return f"{sample.counts:g} counts; the gripper counts 0 to {MOST_COUNTS}"
    if not 0.0 <= sample.opening_m < 0.2:
        return f"an opening of {1e3 * sample.opening_m:g} mm; the gripper opens to less than 200 mm"
    return None
