"""The gripper's opening over its counts, and the tip of a tool from pivoting.

The Robotiq manual calls the relation of counts and opening nonlinear and approximate, and its ends are
software limits; a straight line is wrong by millimetres. The bench uses the table of closing fingers. The
table of opening fingers shows the difference between both directions (hysteresis).

The tip is estimated in the flange or TCP frame from poses with the tip on one fixed point.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial.transform import Rotation

from calibration.order import Change, assess_order, find_change
from calibration.poses import REACH_M, pose_fault, repeated_pose
from calibration.verdict import Assessment, Rejected, length_guess, limits, sift
from drivers.errors import plural
from drivers.types import Pose

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
class GripperResult:
    """The fitted tables by direction, counts (N,) increasing and openings (N,) m; empty if refused.

    hysteresis_m: largest difference between both tables; None if unknown.
    """

    assessment: Assessment
    rejected: tuple[Rejected, ...]
    tables: dict[Direction, tuple[Array, Array]] = field(default_factory=dict)
    hysteresis_m: float | None = None


def calibrate_opening(samples: Sequence[OpeningSample], step_m: float = STEP_M) -> GripperResult:
    """Fit a monotone table for each measured direction; closing is required, opening is optional.

    step_m: change of this gripper's opening per count. A table with another unit than mm is refused.
    """

    def fault(sample: OpeningSample, _: list[OpeningSample]) -> str | None:
        if not (np.isfinite(sample.counts) and np.isfinite(sample.opening_m)):
            return "a value is NaN or infinite"
        if not 0 <= sample.counts <= MOST_COUNTS:
            return f"{sample.counts:g} counts; the gripper counts 0 to {MOST_COUNTS}"
        if not 0.0 <= sample.opening_m < 0.2:
            return f"an opening of {1e3 * sample.opening_m:g} mm; the gripper opens to less than 200 mm"
        return None

    good, rejected = sift(samples, lambda sample: sample.id, fault)
    wrong = _wrong_unit(good if len(good) > len(rejected) else samples, step_m)
    if wrong is not None:
        return GripperResult(Assessment((wrong,)), tuple(rejected))
    counts = {way: _different(s.counts for s in good if s.direction is way) for way in Direction}
    tables = {
        way: _fit_table([s for s in good if s.direction is way])
        for way in Direction
        if counts[way] >= FEWEST_COUNTS
    }
    if Direction.CLOSING not in tables:
        closing = sum(s.direction is Direction.CLOSING for s in good)
        text = (
            f"{plural(closing, 'usable measurement')} while closing; at least {FEWEST_COUNTS} different "
            "counts are needed"
        )
        return GripperResult(Assessment((text,)), tuple(rejected))
    measured = [sample for sample in good if sample.direction in tables]
    missed_m = np.array([s.opening_m - np.interp(s.counts, *tables[s.direction]) for s in measured])
    change = find_change(
        [sample.id for sample in measured],
        [np.array([[1.0, sample.counts / MOST_COUNTS]]) for sample in measured],
        list(missed_m[:, None]),
    )
    misfit_m, fewest = float(np.sqrt((missed_m**2).mean())), min(counts[way] for way in tables)
    assessment = limits(
        (1e3 * misfit_m, 0.3, 2.0, "measurements miss a monotone table by {value:.2f} mm: measure again"),
        (fewest, 6, 3, "{value} counts measured; 8 are good"),
    )
    names = [("the opening", 1e3, "mm", 0.3), ("its change over all counts", 1e3, "mm", 0.3)]
    cure = "did a finger or the gauge shift? Measure all of them again"
    assessment += assess_order(change, len(measured), names, cure)
    hysteresis_m = None
    if len(tables) < 2:
        assessment += Assessment(doubts=("only closing was measured: hysteresis is unknown",))
    else:
        hysteresis_m = _largest_difference_m(*tables.values())
        apart_mm = 1e3 * (hysteresis_m or 0.0)
        assessment += limits((apart_mm, 1.0, np.inf, "closing and opening differ by {value:.1f} mm"))
    return GripperResult(assessment, tuple(rejected), {} if assessment.refusals else tables, hysteresis_m)


Table = tuple[Array, Array]
"""Counts and openings in m, (N,) each."""


def _fit_table(samples: Sequence[OpeningSample]) -> Table:
    """Return the counts and their openings by isotonic regression over the mean at each count."""
    openings = np.array([s.opening_m for s in samples])
    places, where, repeats = np.unique([s.counts for s in samples], return_inverse=True, return_counts=True)
    means = np.bincount(where, openings) / repeats
    return places, np.asarray(isotonic_regression(means, weights=repeats, increasing=False).x)


def _largest_difference_m(one: Table, other: Table) -> float | None:
    """Return the largest difference of the openings where the counts of two tables overlap, else None."""
    at = np.union1d(one[0], other[0])
    at = at[(at >= max(one[0][0], other[0][0])) & (at <= min(one[0][-1], other[0][-1]))]
    return float(np.abs(np.interp(at, *one) - np.interp(at, *other)).max()) if len(at) else None


def _different(counts: Iterable[float]) -> int:
    """Return the number of positions that are at least one count apart."""
    found: list[float] = []
    for value in sorted(counts):
        if not found or value - found[-1] >= 1.0:
            found.append(value)
    return len(found)


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


FEWEST = 4
"""Fewest usable poses."""
_HINT = "tilt the tool by 30 degrees and more, about two axes, with the tip in its hole"


@dataclass(frozen=True, slots=True, eq=False)
class PivotResult:
    """The result. tip_m: (3,) in the tool's frame; None if refused.

    covariance: (3, 3) m^2 of the tip, the larger of fit and leave-one-out; if parts of the poses disagree, it
    covers both. residual_m: per used pose.
    cone_deg: largest rotation between two poses.
    """

    assessment: Assessment
    rejected: tuple[Rejected, ...] = ()
    cone_deg: float = 0.0
    tip_m: Array | None = None
    covariance: Array | None = None
    residual_m: dict[str, float] | None = None


def calibrate_pivot(poses: Sequence[tuple[str, Pose]]) -> PivotResult:
    """Solve R_i tip + p_i = point by least squares over named `base_T_tool` poses, without outliers."""
    good, rejected = sift(
        poses, lambda named: named[0],
        lambda named, kept: pose_fault(named[1], "robot pose", REACH_M) or repeated_pose(named[1], kept),
    )  # fmt: skip
    if len(good) < FEWEST:
        text = f"{plural(len(good), 'usable distinct pose')}; at least {FEWEST} are needed, 10 are good"
        return PivotResult(Assessment((text,)), tuple(rejected))
    names = [name for name, _ in good]
    turns = np.array([pose.rotation.as_matrix() for _, pose in good])
    moves = np.array([pose.position_m for _, pose in good])
    cone_deg, gate = _gate(turns)
    if gate.refusals:
        return PivotResult(gate, tuple(rejected), cone_deg)
    kept = _inliers(turns, moves)
    rejected += [Rejected(names[i], "its tip misses the point of the others") for i in np.flatnonzero(~kept)]
    names = [name for name, used in zip(names, kept, strict=True) if used]
    turns, moves = turns[kept], moves[kept]
    cone_deg, assessment = _gate(turns)
    if len(names) < FEWEST and not assessment.refusals:
        assessment = Assessment((f"{plural(len(names), 'agreeing pose')}; at least {FEWEST} are needed",))
    if assessment.refusals:
        return PivotResult(assessment, tuple(rejected), cone_deg)
    tip, point = solve_pivot(turns, moves)
    missed = turns @ tip + moves - point
    distance = np.linalg.norm(missed, axis=1)
    covariance = _spread(turns, moves, tip, missed)
    change = _find_change(names, turns, missed)
    if change is not None:
        covariance = covariance + change.spread[:3, :3]
    rms_m, sigma_m = float(np.sqrt((distance**2).mean())), float(np.sqrt(np.trace(covariance)))
    assessment += limits(
        (1e3 * rms_m, 1.0, 5.0,
         "the tip misses its point by {value:.2f} mm: did it leave the hole, or the robot still move?"),
        (1e3 * sigma_m, 1.0, 20.0, "the tip is known only to {value:.2f} mm"),
        (len(names), 8, FEWEST, f"{plural(len(names), 'pose')} used; 10 are good"),
    )  # fmt: skip
    parameters = [(f"the {what}'s {axis}", 1e3, "mm", 0.5) for what in ("tip", "hole") for axis in "xyz"]
    cure = "did tip or hole move, or is the hole wider than the tip? Fasten both, and take all poses again"
    assessment += assess_order(change, len(names), parameters, cure)
    if assessment.refusals:
        return PivotResult(assessment, tuple(rejected), cone_deg)
    residual = dict(zip(names, distance.tolist(), strict=True))
    return PivotResult(assessment, tuple(rejected), cone_deg, tip, covariance, residual)


def _find_change(names: Sequence[str], turns: Array, missed: Array) -> Change | None:
    """Compare poses by their order and by their tilt. missed: (N, 3) predicted minus true, m."""
    upright = turns[:, :, 2].mean(axis=0)
    tilt = np.arccos(np.clip(turns[:, :, 2] @ upright / np.linalg.norm(upright), -1.0, 1.0))
    systems = np.split(_system(turns), len(turns))
    return find_change(names, systems, list(-missed), {"tilt": tilt})


def solve_pivot(turns: Array, moves: Array) -> tuple[Array, Array]:
    """Return tip and fixed point, (3,) m each, from rotations (N, 3, 3) and positions (N, 3) m."""
    both, *_ = np.linalg.lstsq(_system(turns), -moves.reshape(-1), rcond=None)
    return both[:3], both[3:]


def _spread(turns: Array, moves: Array, tip: Array, missed: Array) -> Array:
    """Return the covariance of the tip: the larger of fit and jackknife."""
    _, strengths, directions = np.linalg.svd(_system(turns), full_matrices=False)
    count = len(turns)
    noise = float((missed**2).sum()) / max(3 * count - 6, 1)
    spread = directions / strengths[:, None]
    fit = (spread.T @ spread)[:3, :3] * noise
    left_out = [np.delete(np.arange(count), i) for i in range(count)]
    changes = np.array([solve_pivot(turns[others], moves[others])[0] - tip for others in left_out])
    jackknife = (count - 1) / count * changes.T @ changes
    return jackknife if np.trace(jackknife) > np.trace(fit) else fit


def _inliers(turns: Array, moves: Array) -> NDArray[np.bool_]:
    """Remove the worst pose while it exceeds three medians and one millimetre."""
    kept = np.ones(len(turns), bool)
    while kept.sum() > FEWEST:
        tip, point = solve_pivot(turns[kept], moves[kept])
        distance = np.linalg.norm(turns @ tip + moves - point, axis=1)
        worst = int(np.argmax(np.where(kept, distance, -1.0)))
        bound = max(3.0 * float(np.median(distance[kept])), 1e-3)
        if distance[worst] <= bound or kept.sum() <= 0.7 * len(turns):
            return kept
        kept[worst] = False
    return kept


def _gate(turns: Array) -> tuple[float, Assessment]:
    """Return the largest rotation between poses, deg, and whether the rotations determine the tip."""
    first, second = np.triu_indices(len(turns), 1)
    relative = Rotation.from_matrix(turns[second] @ turns[first].transpose(0, 2, 1))
    cone_deg = float(np.degrees(relative.magnitude()).max())
    strengths = np.linalg.svd(_system(turns), compute_uv=False)
    if cone_deg < 10.0:
        return cone_deg, Assessment((f"the tool rotated by at most {cone_deg:.1f} degrees: {_HINT}",))
    if strengths[-1] < 0.02 * strengths[0]:
        reason = f"all rotations are about one axis, so the tip is undetermined along it: {_HINT}"
        return cone_deg, Assessment((reason,))
    text = "the tool rotated by at most {value:.0f} degrees: " + _HINT
    return cone_deg, limits((cone_deg, 30.0, 10.0, text))


def _system(turns: Array) -> Array:
    count = len(turns)
    fixed = np.broadcast_to(-np.eye(3), (count, 3, 3))
    return np.concatenate([turns, fixed], axis=2).reshape(-1, 6)
