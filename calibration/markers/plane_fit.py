"""Fit the homography under which two markers are squares of equal side, with its uncertainty."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from drivers.errors import CalibrationError

Array = NDArray[np.floating]

SQUARE = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
"""A marker of side 1 in its plane, y up, clockwise from the top left."""


class MarkerPlane:
    """The plane of both markers, seen by a camera of known matrix, or by an unknown camera (None).

    Parameters: the plane's pose (6), or without a camera a homography (8); then x, y and rotation of the
    second marker in the plane of the first. Unit of the plane: a marker's side.
    """

    def __init__(self, ideal_px: Array, camera_matrix: Array | None) -> None:
        self._camera_matrix = camera_matrix
        seen = cv2.getPerspectiveTransform(SQUARE.astype(np.float32), ideal_px[0].astype(np.float32))
        first = np.asarray(seen, dtype=np.float64)
        if camera_matrix is None:
            guesses = [first.reshape(-1)[:8]]
        else:
            # one small marker allows two poses; the second marker resolves the ambiguity
            poses = _two_poses(np.linalg.solve(camera_matrix, first))
            guesses = [np.append(turn.as_rotvec(), move) for turn, move in poses]
        self.starts = [np.append(g, _second_marker(self.image_T_plane(g), ideal_px)) for g in guesses]

    def image_T_plane(self, parameters: Array) -> Array:  # noqa: N802
        """Return the homography (3, 3)."""
        if self._camera_matrix is None:
            return np.append(parameters[:8], 1.0).reshape(3, 3)
        pose = Rotation.from_rotvec(parameters[:3]).as_matrix()
        pose[:, 2] = parameters[3:6]
        return self._camera_matrix @ pose

    def normal_and_middle(self, parameters: Array) -> tuple[Array, Array] | None:
        """Return the unit vector towards the camera, (3,), and the middle of both markers, (3,), in sides.

        Both in camera axes; None if the camera is unknown.
        """
        if self._camera_matrix is None:
            return None
        turn, (x, y) = Rotation.from_rotvec(parameters[:3]), _corners_in_plane(parameters[-3:]).mean(axis=0)
        return turn.as_matrix()[:, 2], turn.apply([x, y, 0.0]) + parameters[3:6]


def _two_poses(rays_T_plane: Array) -> list[tuple[Rotation, Array]]:  # noqa: N803
    """Return the pose of a homography, and the one with mirrored tilt, which looks almost the same.

    OpenCV's IPPE_SQUARE returns both as well, but NaN for a plane square to the camera.
    """
    pose = rays_T_plane / np.linalg.norm(rays_T_plane[:, :2], axis=0).mean()
    pose = pose * np.sign(pose[2, 2])
    left, _, right = np.linalg.svd(pose[:, :2], full_matrices=False)
    axes = left @ right
    turn = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    sight = Rotation.align_vectors([[0.0, 0.0, 1.0]], [pose[:, 2]])[0]
    mirror = np.diag([1.0, 1.0, -1.0])
    from_sight = sight.as_matrix()
    leaning_back = from_sight.T @ mirror @ from_sight @ turn @ mirror
    return [(Rotation.from_matrix(r), pose[:, 2]) for r in (turn, leaning_back)]


def _second_marker(image_T_plane: Array, ideal_px: Array) -> Array:  # noqa: N803
    """Return the second marker in the first one's plane: x, y, rotation in rad."""
    corners = cv2.perspectiveTransform(ideal_px[1][None], np.linalg.inv(image_T_plane))[0]
    centre = corners.mean(axis=0)
    square, seen = SQUARE @ (1, 1j), (corners - centre) @ (1, 1j)
    return np.append(centre, np.angle((square.conj() * seen).sum()))


def _corners_in_plane(second: Array) -> Array:
    c, s = np.cos(second[2]), np.sin(second[2])
    return np.vstack([SQUARE, SQUARE @ np.array([[c, s], [-s, c]]) + second[:2]])


def solve(model: MarkerPlane, ideal_px: Array, noise_px: float) -> tuple[Array, Array, float]:
    """Return the best parameters (P,), one-sigma directions (P, P) as rows, and the rms residual in px."""

    def missed(parameters: Array) -> Array:
        plane = np.column_stack([_corners_in_plane(parameters[-3:]), np.ones(8)])
        rays = plane @ model.image_T_plane(parameters).T
        return (rays[:, :2] / rays[:, 2:] - ideal_px.reshape(8, 2)).reshape(-1)

    fits = [least_squares(missed, start, method="lm", x_scale="jac") for start in model.starts]
    best = min(fits, key=lambda fit: fit.cost)
    _, strengths, directions = np.linalg.svd(best.jac, full_matrices=False)
    if not best.success or strengths[-1] < 1e-12 * strengths[0]:
        raise CalibrationError(
            "markers: no plane fits the corners; are the two markers where they should be?"
        )
    free = best.fun.size - best.x.size
    sigma = max(np.sqrt(2 * best.cost / free), noise_px)
    return best.x, directions * (sigma / strengths)[:, None], float(np.sqrt(2 * best.cost / 8))
