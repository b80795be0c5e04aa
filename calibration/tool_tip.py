"""Estimate the tool tip in the flange or TCP frame from poses with the tip on one fixed point (pivoting)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.poses import REACH_M, pose_fault, repeated_pose
from calibration.verdict import Assessment, Rejected, floor, limit, sift
from drivers.errors import counted
from drivers.types import Pose

Array = NDArray[np.floating]

FEWEST = 4
"""Fewest usable poses."""
_HINT = "tilt the tool by 30 degrees and more, about two axes, with the tip in its hole"


@dataclass(frozen=True, slots=True, eq=False)
class PivotResult:
    """The result. tip_m: (3,) in the tool's frame; None if refused.

    covariance: (3, 3) m^2 of the tip, the larger of fit and leave-one-out. residual_m: per used pose.
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
        text = f"{counted(len(good), 'usable distinct pose')}; at least {FEWEST} are needed, 10 are good"
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
        assessment = Assessment((f"{counted(len(names), 'agreeing pose')}; at least {FEWEST} are needed",))
    if assessment.refusals:
        return PivotResult(assessment, tuple(rejected), cone_deg)
    tip, point = solve_pivot(turns, moves)
    missed = turns @ tip + moves - point
    distance = np.linalg.norm(missed, axis=1)
    covariance = _spread(turns, moves, tip, missed)
    assessment += limit(
        1e3 * float(np.sqrt((distance**2).mean())), 1.0, 5.0,
        "the tip misses its point by {value:.2f} mm: did it leave the hole, or the robot still move?",
    )  # fmt: skip
    assessment += limit(
        1e3 * float(np.sqrt(np.trace(covariance))), 1.0, 20.0, "the tip is known only to {value:.2f} mm"
    )
    assessment += floor(len(names), 8, FEWEST, f"{counted(len(names), 'pose')} used; 10 are good")
    if assessment.refusals:
        return PivotResult(assessment, tuple(rejected), cone_deg)
    residual = dict(zip(names, distance.tolist(), strict=True))
    return PivotResult(assessment, tuple(rejected), cone_deg, tip, covariance, residual)


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
    return cone_deg, floor(cone_deg, 30.0, 10.0, "the tool rotated by at most {value:.0f} degrees: " + _HINT)


def _system(turns: Array) -> Array:
    count = len(turns)
    fixed = np.broadcast_to(-np.eye(3), (count, 3, 3))
    return np.concatenate([turns, fixed], axis=2).reshape(-1, 6)
