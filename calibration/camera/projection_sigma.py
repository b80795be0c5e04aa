"""Projection uncertainty over the picture, in px, and the difference between two cameras.

The idea is mrcal's (`mrcal-show-projection-uncertainty`): an error that a rotation of the camera would
undo does not count, so the best rotation is taken out first.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.camera.intrinsics import CameraFit
from calibration.camera.model import CameraModel
from drivers.errors import CalibrationError

Array = NDArray[np.floating]


def projection_sigma_px(result: CameraFit, grid: tuple[int, int] = (16, 12)) -> Array:
    """(rows, columns) px: one sigma, in the worst direction, of where a distant point is projected.

    grid: columns and rows, evenly over the picture with its border.
    """
    camera = result.fit.camera
    rays = camera.rays(camera.grid_px(*grid))
    _, jacobian = camera.project_from(rays, np.zeros(3), np.zeros(3))
    turn, lens = jacobian[:, :3], jacobian[:, [6 + c for c in result.fit.lens.free]]
    q, _ = np.linalg.qr(turn)
    moved = (lens - q @ (q.T @ lens)).reshape(len(rays), 2, -1)
    spread = moved @ result.covariance @ moved.transpose(0, 2, 1)
    return np.sqrt(np.linalg.eigvalsh(spread)[:, -1]).reshape(grid[1], grid[0])


def camera_difference_px(one: CameraModel, other: CameraModel, grid: tuple[int, int] = (16, 12)) -> Array:
    """(rows, columns, 2) px: where the other projects what the first sees, the best rotation taken out.

    Raises `CalibrationError` for cameras of different picture sizes.
    """
    if one.size != other.size:
        raise CalibrationError(
            f"cameras differ in picture size: {one.size} and {other.size}; nothing to compare"
        )
    points = one.grid_px(*grid)
    rays = one.rays(points)

    def missed(turn: Array) -> Array:
        return (other.project(Rotation.from_rotvec(turn).apply(rays)) - points).reshape(-1)

    best = least_squares(missed, np.zeros(3), method="lm", x_scale="jac")
    return np.asarray(best.fun, np.float64).reshape(grid[1], grid[0], 2)
