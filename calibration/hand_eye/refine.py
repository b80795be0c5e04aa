"""Least squares on pixels over X and Z together, plain or robust.

The pose of one marker is uncertain in depth and tilt but accurate across the view, while pixel errors are
equal in both axes. Because the robot connects the views, fitting pixels is several times as accurate as
fitting poses.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.closed_form import Transforms
from calibration.hand_eye.samples import Problem

Array = NDArray[np.floating]

_ROUNDS = 60
"""Most iterations of the refinement."""
_STILL = 1e-9
"""Relative change of the cost below which the iteration has converged."""
_NEAREST_M = 1e-3
"""Smallest depth used in a projection, so that points behind the camera do not divide by zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The result of the iteration. missed_px: (M, 2) residuals. cost: the minimised sum."""

    transforms: Transforms
    missed_px: Array
    cost: float

    @property
    def rms_px(self) -> float:
        """Rms distance of the points, px."""
        return float(np.sqrt((self.missed_px**2).sum(axis=1).mean()))

    def sample_rms_px(self, problem: Problem) -> Array:
        """Return the rms distance per sample, (N,), px."""
        squares = (self.missed_px**2).sum(axis=1)
        counts = np.bincount(problem.owner, minlength=len(problem.ids))
        return np.sqrt(np.bincount(problem.owner, squares, len(problem.ids)) / np.maximum(counts, 1))


def refine(problem: Problem, start: Transforms, soft_px: float | None = None) -> Refined:
    """Minimise by Levenberg-Marquardt. soft_px: width of a soft-L1 loss; None for squares.

    Steps rotate X and Z about their own axes and translate them. Columns are scaled before each solve, so
    that m and rad have similar weight. Stops when the cost has converged, after 60 rounds at the latest.
    """
    now, damping = start, 1e-4
    missed, jacobian = linearised(problem, now)
    cost, weights = _loss(missed, soft_px)
    for _ in range(_ROUNDS):
        step = _step(jacobian, missed, weights, damping)
        candidate = moved(now, step)
        new_missed, new_jacobian = linearised(problem, candidate)
        new_cost, new_weights = _loss(new_missed, soft_px)
        if new_cost <= cost:
            done = cost - new_cost <= _STILL * cost
            now, missed, jacobian, cost, weights = candidate, new_missed, new_jacobian, new_cost, new_weights
            damping = max(damping / 10.0, 1e-9)
            if done:
                break
        elif damping > 1e6:
            break
        else:
            damping *= 10.0
    return Refined(now, missed, cost)


def linearised(problem: Problem, at: Transforms) -> tuple[Array, Array]:
    """Return the residuals (M, 2) of the prediction, px, and their derivatives (M, 2, 12).

    Columns: rotation of X (about its own axes), translation of X (base or tcp axes), then of Z likewise.
    """
    a_R, a_t = problem.a_R[problem.owner], problem.a_t[problem.owner]  # noqa: N806
    carried = problem.points_m @ at.z_R.T + at.z_t
    seen = ((a_R @ carried[..., None])[..., 0] + a_t - at.x_t) @ at.x_R
    to_camera = at.x_R.T @ a_R
    by_pose = np.concatenate(
        [
            cross_matrices(seen),
            np.broadcast_to(-at.x_R.T, a_R.shape),
            -to_camera @ at.z_R @ cross_matrices(problem.points_m),
            to_camera,
        ],
        axis=2,
    )
    depth = np.where(seen[:, 2] > _NEAREST_M, seen[:, 2], _NEAREST_M)
    flat = seen[:, :2] / depth[:, None]
    missed = problem.focal * flat + problem.centre - problem.pixels
    scale = (problem.focal / depth[:, None])[..., None]
    return missed, scale * (by_pose[:, :2] - flat[..., None] * by_pose[:, 2:])


def moved(at: Transforms, step: Array) -> Transforms:
    """Apply a (12,) step to both transforms."""
    turns = Rotation.from_rotvec(step.reshape(4, 3)[[0, 2]]).as_matrix()
    return Transforms(at.x_R @ turns[0], at.x_t + step[3:6], at.z_R @ turns[1], at.z_t + step[9:])


def cross_matrices(vectors: Array) -> Array:
    """(M, 3, 3) matrices of the cross product with each of (M, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _loss(missed: Array, soft_px: float | None) -> tuple[float, Array]:
    """Return the cost and the weights (M,) of points: squares, or soft-L1 of their distances."""
    squares = (missed**2).sum(axis=1)
    if soft_px is None:
        return float(squares.sum()), np.ones(len(missed))
    root = np.sqrt(1.0 + squares / soft_px**2)
    return float(2.0 * soft_px**2 * (root - 1.0).sum()), 1.0 / root


def _step(jacobian: Array, missed: Array, weights: Array, damping: float) -> Array:
    """Return the damped Gauss-Newton step by QR of the scaled, augmented system."""
    root = np.sqrt(weights)[:, None]
    rows = (jacobian * root[..., None]).reshape(-1, 12)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    system = np.vstack([rows / scale, np.sqrt(damping) * np.eye(12)])
    target = np.concatenate([-(missed * root).reshape(-1), np.zeros(12)])
    q, r = np.linalg.qr(system)
    return np.linalg.solve(r, q.T @ target) / scale
