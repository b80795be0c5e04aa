"""Uncertainty of a hand-eye estimate, from the samples and from the camera calibration.

The covariance of the fit ignores the robot's errors, which all points of a picture share. The jackknife
includes them, but is noisy for few samples. In each direction the larger one is used. Neither includes the
camera's own error, which is the same in all samples: a focal length wrong by 0.2 % displaces a camera at 0.9
m by 2 mm without larger residuals. So the change of the estimate with cameras that are wrong by one sigma is
added.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from calibration.hand_eye.closed_form import Transforms
from calibration.hand_eye.refine import Refined, linearised, refine
from calibration.hand_eye.samples import Problem

Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariances (6, 6) of X: rotation vector about X's own axes (rad), then translation (m).

    covariance: the larger of fit and jackknife in each direction, plus the camera's. camera: part caused by
    the camera calibration; zero if the camera is exact. held_out_px: (N,) rms px by which the estimate from
    all other samples misses each sample. samples: N.
    """

    covariance: Array
    camera: Array
    held_out_px: Array
    samples: int

    @property
    def sigma_m(self) -> Array:
        """(3,) one sigma of the translation."""
        return np.sqrt(np.diag(self.covariance)[3:])

    @property
    def sigma_rad(self) -> Array:
        """(3,) one sigma of the rotation."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def camera_sigma_m(self) -> Array:
        """(3,) one sigma of the translation caused by the camera calibration."""
        return np.sqrt(np.diag(self.camera)[3:])

    @property
    def camera_sigma_rad(self) -> Array:
        """(3,) one sigma of the rotation caused by the camera calibration."""
        return np.sqrt(np.diag(self.camera)[:3])

    @property
    def held_out_rms_px(self) -> float:
        """Rms of `held_out_px`."""
        return float(np.sqrt((self.held_out_px**2).mean()))

    def region_bound(self, dimensions: int, level: float = 0.95) -> float:
        """Return the squared Mahalanobis distance that contains the truth at a confidence level (F test)."""
        return float(dimensions * f_distribution.ppf(level, dimensions, max(self.samples - 1, 1)))

    def holds(self, error: Array, level: float = 0.95) -> bool:
        """Whether a (6,) error lies within the confidence region."""
        return float(error @ np.linalg.solve(self.covariance, error)) <= self.region_bound(6, level)


def uncertainty(problem: Problem, answer: Refined) -> Uncertainty:
    """Compute the uncertainty: one short refit per sample, and per direction of the camera's covariance."""
    count = len(problem.ids)
    changes, held_out = np.zeros((count, 6)), np.zeros(count)
    for i in range(count):
        without = refine(problem.without(i), answer.transforms).transforms
        changes[i] = _change(answer.transforms, without)
        missed, _ = linearised(problem.subset(np.array([i])), without)
        held_out[i] = np.sqrt((missed**2).sum(axis=1).mean())
    jackknife = (count - 1) / count * changes.T @ changes
    camera = _camera_covariance(problem, answer)
    samples = larger_of(_fit_covariance(problem, answer.transforms), jackknife)
    return Uncertainty(samples + camera, camera, held_out, count)


def _camera_covariance(problem: Problem, answer: Refined) -> Array:
    """Return the covariance (6, 6) of X from refits with cameras that are wrong by one sigma."""
    changes = [
        _change(answer.transforms, refine(problem.seen_by(camera), answer.transforms).transforms)
        for camera in problem.camera.off_by_one_sigma()
    ]
    stacked = np.array(changes).reshape(-1, 6)
    return stacked.T @ stacked


def _change(one: Transforms, other: Transforms) -> Array:
    """Return (6,): rotation from one X to the other about its own axes (rad), and translation (m)."""
    turn = Rotation.from_matrix(one.x_R.T @ other.x_R).as_rotvec()
    return np.concatenate([turn, other.x_t - one.x_t])


def _fit_covariance(problem: Problem, at: Transforms) -> Array:
    """Return the covariance (6, 6) of X from the Jacobian by SVD, scaled by the larger of two variances.

    One variance is over all pixels. The other is over the residuals that a rigid motion of the target in each
    picture could explain, because a wrong robot pose causes such residuals, and all points of a picture share
    it.
    """
    missed, jacobian = linearised(problem, at)
    rows, count = jacobian.reshape(-1, 12), len(problem.ids)
    scale = np.linalg.norm(rows, axis=0)
    _, strengths, directions = np.linalg.svd(rows / scale, full_matrices=False)
    spread = directions / np.maximum(strengths, 1e-12)[:, None] / scale
    pixels = float((missed**2).sum()) / max(rows.shape[0] - 12, 1)
    rigid = 0.0
    for sample in range(count):
        mine = problem.owner == sample
        by_target = jacobian[mine].reshape(-1, 12)[:, 6:]
        q, _ = np.linalg.qr(by_target / np.maximum(np.linalg.norm(by_target, axis=0), 1e-12))
        rigid += float(((q.T @ missed[mine].reshape(-1)) ** 2).sum())
    variance = max(pixels, rigid / max(6 * count - 12, 1))
    return (spread.T @ spread)[:6, :6] * variance


def larger_of(one: Array, other: Array) -> Array:
    """Return a covariance that is the larger of two in each common principal direction; both positive.

    Directions in which one is nearly zero get a lower bound, so that the matrices can be inverted.
    """
    scale = np.sqrt(np.maximum(np.diag(one), np.diag(other)))
    scaled_one, scaled_other = one / np.outer(scale, scale), other / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled_one)
    root = vectors * np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    white = np.linalg.solve(root, np.linalg.solve(root, scaled_other).T)
    ratio, axes = np.linalg.eigh((white + white.T) / 2)
    mixed = root @ axes
    return (mixed * np.maximum(ratio, 1.0)) @ mixed.T * np.outer(scale, scale)
