"""Simulated images of flat targets with a known camera, rendered pixel by pixel."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.targets.boards import Charuco, Target
from calibration.targets.sheets import TargetPicture, target_picture
from drivers.types import Image, Pose

Array = NDArray[np.floating]

BOARD = Charuco((8, 6), 0.025, 0.018, "DICT_5X5_100")
CAMERA = CameraModel(
    (1280, 720),
    np.array([[982.0, 0.0, 648.0], [0.0, 979.0, 352.0], [0.0, 0.0, 1.0]]),
    np.array([-0.12, 0.06, 0.0008, -0.0005, 0.0]),
)
_OVERSAMPLING = 2
_BLUR_PX, _NOISE_GREY = 0.8, 3.0  # standard deviations of lens blur and noise


def render_target(
    target: Target,
    camera: CameraModel,
    camera_T_target: Pose,  # noqa: N803
    rng: np.random.Generator,
) -> Image:
    """Return an image, (H, W) uint8, of a flat target on a grey bench; parts outside it are clipped."""
    picture = target_picture(target.spec)
    width, height = camera.size
    rays = _fine_rays(camera)
    shape = height * _OVERSAMPLING, width * _OVERSAMPLING, 2
    where = _on_target(rays, camera_T_target, picture).reshape(shape).astype(np.float32)
    lit = cv2.remap(picture.grey, where, None, cv2.INTER_LINEAR, borderValue=120)  # type: ignore[call-overload]
    small = cv2.resize(lit.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
    noisy = blurred + rng.normal(0.0, _NOISE_GREY, blurred.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def board_pose(
    rng: np.random.Generator, tilt_deg: tuple[float, float] = (5.0, 45.0), reach: float = 1.0
) -> Pose:
    """Draw a pose of the standard board in view. reach: range of its middle, as a fraction of the image."""
    distance = rng.uniform(0.28, 0.5)
    half = np.array([640.0, 360.0]) / 980.0 * distance * 0.75 * reach
    middle = np.append(rng.uniform(-half, half), distance)
    axis = rng.normal(0, 1, 2)
    tilt = np.append(axis / np.linalg.norm(axis), 0.0) * np.radians(rng.uniform(*tilt_deg))
    turn = Rotation.from_rotvec(tilt) * Rotation.from_euler("z", rng.uniform(-40, 40), degrees=True)
    return Pose.from_rotation(middle - turn.apply([0.1, 0.075, 0.0]), turn)


@lru_cache(maxsize=2)
def _fine_rays(camera: CameraModel) -> Array:
    """Return the rays of all sub-pixels, row by row; cached, because this takes longer than rendering."""
    width, height = camera.size
    offset = (np.arange(_OVERSAMPLING) + 0.5) / _OVERSAMPLING - 0.5
    columns, rows = ((np.arange(n)[:, None] + offset).ravel() for n in (width, height))
    x, y = np.meshgrid(columns, rows)
    return camera.rays(np.column_stack([x.ravel(), y.ravel()]))


def _on_target(rays: Array, camera_T_target: Pose, picture: TargetPicture) -> Array:  # noqa: N803
    """Return the intersections of rays with the target's plane, in pixels of the target's picture."""
    back = camera_T_target.inverse()
    towards = back.rotation.apply(rays)
    start = np.asarray(back.position_m)
    along = np.where(np.abs(towards[:, 2]) > 1e-9, -start[2] / towards[:, 2], -1.0)
    met = start[:2] + along[:, None] * towards[:, :2]
    met[along <= 0] = 1e6
    return (met - picture.origin_m) * picture.px_per_m - 0.5
