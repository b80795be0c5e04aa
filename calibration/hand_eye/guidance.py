"""Choose the next robot pose: the candidate that most reduces the predicted uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.hand_eye.closed_form import Transforms
from calibration.hand_eye.refine import linearised
from calibration.hand_eye.samples import HandEyeSample, Problem, Setup, make_problem
from calibration.hand_eye.solve import HandEyeResult
from calibration.targets.boards import View
from drivers.errors import CalibrationError
from drivers.types import Pose

Array = NDArray[np.floating]

_BORDER_PX = 10.0
"""Corners nearer to the border count as outside the picture."""
_LARGEST_TILT = np.cos(np.radians(60.0))
"""Cosine of the largest angle between the target's normal and the line of sight."""
_LEVER_M = 0.3
"""A rotation counts as the displacement that it causes at this distance from the camera."""


@dataclass(frozen=True, slots=True)
class NextPose:
    """Index of a candidate, and the predicted one sigma (m, at 0.3 m from the camera) after adding it."""

    index: int
    sigma_m: float


def next_pose(result: HandEyeResult, camera: CameraModel, candidates: Sequence[Pose]) -> NextPose | None:
    """Choose among reachable `base_T_tcp`; None if no candidate shows the target to the camera.

    Raises `CalibrationError` if there is no first estimate yet.
    """
    if result.problem is None or result.refined is None or result.pose is None or result.target is None:
        raise CalibrationError(
            "hand-eye: no estimate yet to improve; visit poses rotated by 30 degrees about two axes"
        )
    camera_T_base_or_tcp, at = result.pose.inverse(), result.refined.transforms  # noqa: N806
    points = np.unique(result.problem.points_m, axis=0)
    known = _information(result.problem, at)
    noise = max(result.refined.rms_px / np.sqrt(2.0), 0.05)
    best: NextPose | None = None
    for index, pose in enumerate(candidates):
        robot = pose if result.setup is Setup.EYE_TO_HAND else pose.inverse()
        view = _predicted_view(camera, points, camera_T_base_or_tcp @ robot @ result.target)
        if view is None:
            continue
        seen = make_problem([HandEyeSample("next", pose, view)], camera, result.setup)
        sigma_m = _sigma_m(known + _information(seen, at), noise)
        if best is None or sigma_m < best.sigma_m:
            best = NextPose(index, sigma_m)
    return best


def _predicted_view(camera: CameraModel, points_m: Array, camera_T_target: Pose) -> View | None:  # noqa: N803
    """Return what the camera would see; None if the target is outside the picture or too oblique."""
    in_camera = camera_T_target.rotation.apply(points_m) + np.asarray(camera_T_target.position_m)
    normal = camera_T_target.rotation.as_matrix()[:, 2]
    sight = np.asarray(camera_T_target.position_m) / np.linalg.norm(camera_T_target.position_m)
    if in_camera[:, 2].min() < 0.05 or abs(float(normal @ sight)) < _LARGEST_TILT:
        return None
    pixels = camera.project(in_camera)
    inside = (pixels > _BORDER_PX).all() and (pixels < np.subtract(camera.size, 1 + _BORDER_PX)).all()
    return View("next", np.arange(len(points_m)), points_m, pixels, camera.size) if inside else None


def _information(problem: Problem, at: Transforms) -> Array:
    """Return the information matrix (12, 12) of X and Z: J^T J, in px^-2."""
    _, jacobian = linearised(problem, at)
    rows = jacobian.reshape(-1, 12)
    return rows.T @ rows


def _sigma_m(information: Array, noise_px: float) -> float:
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    turn, move = np.diag(covariance)[:3].sum(), np.diag(covariance)[3:6].sum()
    return float(noise_px * np.sqrt(move + _LEVER_M**2 * turn))
