"""Uncertainty of a hand-eye answer: what the samples leave open, and what the camera does.

The covariance of the fit misses the robot's errors, which all points of a picture share; the jackknife
includes them, but is noisy for few samples. In each direction the larger one counts. Neither sees the
camera's own error, which is the same in all samples: a focal length off by 0.2 % moves a camera at 0.9 m
by 2 mm, and the residuals stay as small. So the answer of cameras that are off by one sigma is added.
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

    covariance: the larger of fit and jackknife in each direction, and the camera's. camera: from that of the
    camera; zero where it is exact. held_out_px: (N,) rms px by which each sample is missed by the answer from
    all others. samples: N.
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
        """(3,) one sigma of the translation that the camera's own uncertainty leaves."""
        return np.sqrt(np.diag(self.camera)[3:])

    @property
    def camera_sigma_rad(self) -> Array:
        """(3,) one sigma of the rotation, likewise."""
        return np.sqrt(np.diag(self.camera)[:3])

    @property
    def held_out_rms_px(self) -> float:
        """Rms of `held_out_px`."""
        return float(np.sqrt((self.held_out_px**2).mean()))

    def region_bound(self, dimensions: int, level: float = 0.95) -> float:
        """Squared Mahalanobis distance that holds the truth with probability `level` (F, samples - 1)."""
        return float(dimensions * f_distribution.ppf(level, dimensions, max(self.samples - 1, 1)))

    def holds(self, error: Array, level: float = 0.95) -> bool:
        """Whether a (6,) error lies within the confidence region."""
        return float(error @ np.linalg.solve(self.covariance, error)) <= self.region_bound(6, level)


def uncertainty(problem: Problem, answer: Refined) -> Uncertainty:
    """Of the samples and of the camera; one short refit per sample and per direction of the camera's."""
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
    """(6, 6) of X: what the answer changes with cameras that are off by one sigma."""
    changes = [
        _change(answer.transforms, refine(problem.seen_by(camera), answer.transforms).transforms)
        for camera in problem.camera.off_by_one_sigma()
    ]
    stacked = np.array(changes).reshape(-1, 6)
    return stacked.T @ stacked


def _change(one: Transforms, other: Transforms) -> Array:
    """(6,): turn from one X to the other about its own axes (rad), and move (m)."""
    turn = Rotation.from_matrix(one.x_R.T @ other.x_R).as_rotvec()
    return np.concatenate([turn, other.x_t - one.x_t])


def _fit_covariance(problem: Problem, at: Transforms) -> Array:
    """(6, 6) of X from the Jacobian by SVD, scaled by the larger of two residual variances.

    One is over all pixels; the other over what a rigid move of the target in each picture could
    explain, because that is where a wrong robot pose goes, and all points of a picture share it.
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
    """A covariance that is in each common principal direction the larger of two; both positive.

    Directions in which one is next to nothing are bounded below, so that it can be solved with.
    """
    scale = np.sqrt(np.maximum(np.diag(one), np.diag(other)))
    scaled_one, scaled_other = one / np.outer(scale, scale), other / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled_one)
    root = vectors * np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    white = np.linalg.solve(root, np.linalg.solve(root, scaled_other).T)
    ratio, axes = np.linalg.eigh((white + white.T) / 2)
    mixed = root @ axes
    return (mixed * np.maximum(ratio, 1.0)) @ mixed.T * np.outer(scale, scale)
