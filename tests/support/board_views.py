"""Views of boards as points, without drawing a picture."""

import numpy as np

from calibration.camera.model import CameraModel
from calibration.targets.boards import Charuco, View
from drivers.types import Pose


def exact_view(
    target: Charuco,
    camera: CameraModel,
    camera_T_target: Pose,  # noqa: N803
    name: str,
    rng: np.random.Generator,
    noise_px: float = 0.06,
) -> View:
    """Return the corners of a board with the noise of a detector, without those outside the picture."""
    places = np.asarray(target.board().getChessboardCorners(), np.float64)
    seen = camera.project(camera_T_target.rotation.apply(places) + np.asarray(camera_T_target.position_m))
    inside = (seen > 3.0).all(axis=1) & (seen < np.subtract(camera.size, 4.0)).all(axis=1)
    ids = np.flatnonzero(inside)
    return View(name, ids, places[ids], rng.normal(seen[ids], noise_px), camera.size)
