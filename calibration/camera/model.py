"""Camera model: pinhole with OpenCV's distortion; projects points and rays, and holds its uncertainty."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
LEAST_FOCAL = 0.1
"""Shortest focal length of a pinhole lens, as a fraction of the longer side: it sees 157 degrees across."""


@dataclass(frozen=True, slots=True)
class LensModel:
    """A choice of lens terms: which of fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 are free.

    `flags` are OpenCV's; `free` are the columns of `cv2.projectPoints`' Jacobian after those of the pose.
    """

    name: str
    flags: int
    free: tuple[int, ...]


_NO_TANGENT, _NO_K3 = cv2.CALIB_ZERO_TANGENT_DIST, cv2.CALIB_FIX_K3
LENS_MODELS = (
    LensModel("pinhole", _NO_TANGENT | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | _NO_K3, (0, 1, 2, 3)),
    LensModel("radial1", _NO_TANGENT | cv2.CALIB_FIX_K2 | _NO_K3, (0, 1, 2, 3, 4)),
    LensModel("radial2", _NO_TANGENT | _NO_K3, (0, 1, 2, 3, 4, 5)),
    LensModel("plumb_bob4", _NO_K3, tuple(range(8))),
    LensModel("plumb_bob", 0, tuple(range(9))),
    LensModel("rational", cv2.CALIB_RATIONAL_MODEL, tuple(range(12))),
)
"""From simple to rich; `plumb_bob` and `rational` are ROS' names."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraUncertainty:
    """Uncertainty of a camera, for results that depend on it.

    terms: the terms, of fx, fy, cx, cy and the eight distortion terms, to which the covariance (P, P)
    belongs, as in `LensModel.free`. doubts: why its calibration is not good; each with advice.
    """

    terms: tuple[int, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """A pinhole camera with a lens. All code outside the simulator uses this model.

    size: width and height in px. matrix: (3, 3) px. distortion: (5,) or (8,), OpenCV's order. Pixel centres
    are integers (OpenCV's convention). uncertainty: None if the camera is exact, as in drawn pictures.
    """

    size: tuple[int, int]
    matrix: Array
    distortion: Array
    uncertainty: CameraUncertainty | None = None

    @classmethod
    def pinhole(cls, size: tuple[int, int], focal_px: float) -> "CameraModel":
        """Return a camera without distortion whose axis passes through the middle of the picture."""
        (width, height), f = size, focal_px
        matrix = np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])
        return cls(size, matrix, np.zeros(5))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the camera is not known well; empty if it is."""
        return () if self.uncertainty is None else self.uncertainty.doubts

    def off_by_one_sigma(self) -> list["CameraModel"]:
        """Return equally likely cameras, each wrong by one sigma along one direction of the uncertainty.

        For any quantity computed with each of them, the differences to its value with this camera are the
        columns of a square root of the covariance that the camera's uncertainty causes.
        """
        if self.uncertainty is None:
            return []
        covariance, cameras = self.uncertainty.covariance, []
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        # (P, 12) steps of fx, fy, cx, cy and the distortion, whose outer products sum to the covariance
        steps = np.zeros((len(values), 12))
        steps[:, list(self.uncertainty.terms)] = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
        for step in steps[values > 0.0]:
            matrix = self.matrix.copy()
            matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
            terms = 5 if len(self.distortion) <= 5 and not step[9:].any() else 8
            distortion = np.pad(self.distortion, (0, terms - len(self.distortion))) + step[4 : 4 + terms]
            cameras.append(replace(self, matrix=matrix, distortion=distortion, uncertainty=None))
        return cameras

    def project(self, points: Array) -> Array:
        """Project (N, 3) points in camera axes to (N, 2) px."""
        return self.project_from(points, np.zeros(3), np.zeros(3))[0]

    def project_from(self, points: Array, turn: Array, move: Array) -> tuple[Array, Array]:
        """Project (N, 3) points of a body at a pose: (N, 2) px, and their Jacobian (2 N, 18).

        turn: rotation vector, rad; move: translation, m. Columns: turn, move, then fx, fy, cx, cy and the
        eight distortion terms; columns of terms that the camera lacks are zero.
        """
        seen, jacobian = cv2.projectPoints(points, turn, move, self.matrix, self.distortion)
        missing = max(0, 18 - jacobian.shape[1])
        padded = np.pad(np.asarray(jacobian[:, :18], np.float64), ((0, 0), (0, missing)))
        return np.asarray(seen, np.float64).reshape(-1, 2), padded

    def undistort(self, points_px: Array) -> Array:
        """Map (..., 2) px to the position in a camera of the same matrix without distortion, px."""
        flat = np.ascontiguousarray(points_px.reshape(-1, 1, 2), dtype=np.float64)
        ideal = cv2.undistortPoints(flat, self.matrix, self.distortion, P=self.matrix)
        return ideal.reshape(points_px.shape).astype(np.float64)

    def rays(self, points_px: Array) -> Array:
        """Return unit vectors (N, 3) towards (N, 2) px, camera axes."""
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        flat = np.ascontiguousarray(points_px, np.float64).reshape(-1, 1, 2)
        undistort = getattr(cv2, "undistortPointsIter", None)
        lens = flat, self.matrix, self.distortion
        ideal = undistort(*lens, np.eye(3), np.eye(3), stop) if undistort else cv2.undistortPoints(*lens)
        rays = np.column_stack([ideal.reshape(-1, 2), np.ones(len(flat))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def grid_px(self, columns: int = 16, rows: int = 12) -> Array:
        """Return points evenly spaced over the picture, border included, (rows * columns, 2) px."""
        width, height = self.size
        x, y = np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows))
        return np.column_stack([x.ravel(), y.ravel()])
