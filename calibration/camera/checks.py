"""Quality of a camera fit: its views, its projection uncertainty over the picture, and its verdict.

Projection uncertainty over the picture is mrcal's method (`mrcal-show-projection-uncertainty`): an error that
a rotation of the camera compensates does not count, so the best rotation is removed first.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.camera.intrinsics import CameraFit, neighbour_correlation
from calibration.camera.model import CameraModel
from calibration.targets.boards import Array, coverage
from calibration.verdict import Assessment, floor, limit
from drivers.errors import CalibrationError, counted

_GRID = (16, 12)
"""Columns and rows of the grid over the picture, including its border."""


def board_tilts_deg(result: CameraFit) -> tuple[float, float]:
    """Return the largest angle between the board's normals in two views, and to the optical axis, deg."""
    normals = Rotation.from_rotvec(result.fit.rotations).as_matrix()[:, :, 2]
    sines = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    spread = np.degrees(np.arctan2(sines, np.abs(normals @ normals.T))).max()
    tilts = np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), np.abs(normals[:, 2]))
    return float(spread), float(np.degrees(tilts).max())


def covered(result: CameraFit) -> float:
    """Return the fraction of the picture in which corners were seen."""
    return float((coverage(result.fit.views) > 0).mean())


def projection_sigma_px(result: CameraFit) -> Array:
    """Return one sigma of the projection of a distant point, in the worst direction, (12, 16) px."""
    camera = result.fit.camera
    rays = camera.rays(camera.grid_px(*_GRID))
    _, jacobian = camera.project_from(rays, np.zeros(3), np.zeros(3))
    turn, lens = jacobian[:, :3], jacobian[:, [6 + c for c in result.fit.lens.free]]
    q, _ = np.linalg.qr(turn)
    moved = (lens - q @ (q.T @ lens)).reshape(len(rays), 2, -1)
    spread = moved @ result.covariance @ moved.transpose(0, 2, 1)
    return np.sqrt(np.linalg.eigvalsh(spread)[:, -1]).reshape(_GRID[::-1])


def camera_difference_px(one: CameraModel, other: CameraModel) -> Array:
    """Return the differences in projection between two cameras, (12, 16, 2) px, best rotation removed.

    Raises `CalibrationError` for cameras of different picture sizes.
    """
    if one.size != other.size:
        raise CalibrationError(
            f"cameras differ in picture size: {one.size} and {other.size}; nothing to compare"
        )
    points = one.grid_px(*_GRID)
    rays = one.rays(points)

    def missed(turn: Array) -> Array:
        return (other.project(Rotation.from_rotvec(turn).apply(rays)) - points).reshape(-1)

    best = least_squares(missed, np.zeros(3), method="lm", x_scale="jac")
    return np.asarray(best.fun, np.float64).reshape(*_GRID[::-1], 2)


def assess_camera(result: CameraFit) -> Assessment:
    """Assess a camera fit by tilt, focal uncertainty, coverage, number of views and held-out error."""
    views = len(result.fit.views)
    focal = float(result.sigma[:2].max() / result.fit.camera.matrix[0, 0])
    bent = limit(
        neighbour_correlation(result.fit), 0.4, np.inf,
        "errors of neighbouring corners are correlated ({value:.2f}; noise: 0): focus moved, or board bent?",
        "correlation of the errors of neighbouring corners: {value:.2f}",
    )  # fmt: skip
    known = limit(
        100 * focal, 0.5, 10.0, "the focal length is known only to {value:.2g} %: add tilted, nearer views"
    )
    unseen = limit(
        result.held_out_rms_px / max(result.fit.rms_px, 0.02), 2.0, 10.0,
        "held-out views have {value:.1f} times the error of fitted ones: something moved, or too few views",
    )  # fmt: skip
    mapped = limit(
        float(projection_sigma_px(result).max()), 0.5, np.inf,
        "projection is uncertain by up to {value:.2f} px in the picture: add nearer views, tilted by 30 "
        "degrees, over its corners",
    )  # fmt: skip
    seen = floor(
        covered(result), 0.6, 0.0,
        "corners cover {value:.0%} of the picture; the lens is extrapolated elsewhere: add views there",
    )  # fmt: skip
    enough = floor(views, 10, 3, f"{counted(views, 'distinct view')}; ten to twenty are good")
    noise = limit(
        result.noise_px, 1.0, 5.0, "corners are found only to {value:.2f} px: is the board in focus?"
    )
    tilts = _assess_tilts(*board_tilts_deg(result))
    return bent + tilts + known + unseen + mapped + seen + enough + noise


def _assess_tilts(spread_deg: float, largest_deg: float) -> Assessment:
    """Assess tilts: square-on views do not determine the focal length; a single tilt determines it badly."""
    hint = "tilt the board by 30 degrees each way"
    if spread_deg < 10.0 and largest_deg < 15.0:
        return Assessment(
            refusals=(f"all views are square-on (tilted by {largest_deg:.1f} degrees at most): {hint}",)
        )
    return floor(
        spread_deg, 20.0, 0.0, "the board's tilt varied only by {value:.1f} degrees: " + hint,
        "the board's tilt varied by {value:.1f} degrees",
    )  # fmt: skip
