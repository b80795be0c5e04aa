"""Assessment of a camera fit: what its views determine, and what they do not."""

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.intrinsics import CameraFit, neighbour_correlation
from calibration.camera.projection_sigma import projection_sigma_px
from calibration.targets.views import Array, coverage
from calibration.verdict import Assessment, floor, limit
from drivers.errors import counted

GOOD_VIEWS = 10


def board_tilts_deg(result: CameraFit) -> Array:
    """(V,): angle between each view's board normal and the optical axis."""
    normals = Rotation.from_rotvec(result.fit.rotations).as_matrix()[:, :, 2]
    return np.degrees(np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), np.abs(normals[:, 2])))


def tilt_spread_deg(result: CameraFit) -> float:
    """The largest angle between two views' board normals."""
    normals = Rotation.from_rotvec(result.fit.rotations).as_matrix()[:, :, 2]
    sines = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    return float(np.degrees(np.arctan2(sines, np.abs(normals @ normals.T))).max())


def assess_camera(result: CameraFit) -> Assessment:
    """Assess a camera fit by tilt, focal uncertainty, coverage, number of views and held-out error."""
    camera = result.fit.camera
    covered = float((coverage(result.fit.views) > 0).mean())
    focal = float(result.sigma[:2].max() / camera.matrix[0, 0])
    sigma_px = projection_sigma_px(result)
    tilts = _assess_tilts(tilt_spread_deg(result), float(board_tilts_deg(result).max()))
    known = limit(
        100 * focal, 0.5, 10.0, "the focal length is known to {value:.2g} % only: add tilted, nearer views"
    )
    seen = floor(
        covered,
        0.6,
        0.0,
        "corners cover {value:.0%} of the picture; beyond them the lens is extrapolated: add views there",
    )
    enough = floor(
        len(result.fit.views), GOOD_VIEWS, 3,
        f"{counted(len(result.fit.views), 'distinct view')}; ten to twenty are good",
    )  # fmt: skip
    mapped = limit(
        float(sigma_px.max()), 0.5, np.inf,
        "projection is uncertain by up to {value:.2f} px in the picture: add nearer views, tilted by 30 "
        "degrees, over its corners",
    )  # fmt: skip
    unseen = limit(
        result.held_out_rms_px / max(result.fit.rms_px, 0.02), 2.0, 10.0,
        "views not fitted are missed {value:.1f} times as far as fitted ones: something moved, or too few",
    )  # fmt: skip
    noise = limit(
        result.noise_px, 1.0, 5.0, "corners are found to {value:.2f} px only: is the board in focus?"
    )
    bent = limit(
        neighbour_correlation(result.fit), 0.4, np.inf,
        "errors of neighbouring corners are alike ({value:.2f}; noise: 0): focus moved, or board bent?",
        "correlation of the errors of neighbouring corners: {value:.2f}",
    )  # fmt: skip
    return bent + tilts + known + unseen + mapped + seen + enough + noise


def _assess_tilts(spread_deg: float, largest_deg: float) -> Assessment:
    """Square-on views do not determine the focal length; views that share one tilt determine it badly."""
    hint = "tilt the board by 30 degrees each way"
    if spread_deg < 10.0 and largest_deg < 15.0:
        return Assessment(
            refusals=(f"all views are square-on (tilted by {largest_deg:.1f} degrees at most): {hint}",)
        )
    return floor(
        spread_deg,
        20.0,
        0.0,
        "the board's tilt hardly changed ({value:.1f} degrees in all): " + hint,
        "the board's tilt changed by {value:.1f} degrees in all",
    )
