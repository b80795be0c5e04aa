"""Simulated images with ground truth for calibrations: markers on an object."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.types import Image, Pose
from fakes.camera.marker_scene import MarkerScene

_FACING = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The object's axes (x right, z up, y away) in camera axes (x right, y down, z away)."""
_SIDE_M = 0.030
_FOCAL_PX = 640.0


@dataclass(frozen=True, slots=True)
class MarkerPictures:
    """Images of two tilted 30 mm markers, centres 100 mm apart, 640 x 480 px.

    noise_grey: sigma of noise. scene: the markers, with the true camera's matrix and distortion.
    """

    side_px: float = 40.0
    tilt_deg: float = 15.0
    blur_px: float = 1.0
    noise_grey: float = 4.0
    ids: tuple[int, int] = (0, 1)
    dictionary: str = "DICT_4X4_50"
    scene: MarkerScene = field(init=False)

    def __post_init__(self) -> None:
        scene = MarkerScene(
            focal_px=_FOCAL_PX, unit_seed=1, marker_ids=self.ids, dictionary=self.dictionary,
            marker_side_m=_SIDE_M, marker_centres_m=((-0.05, 0.0), (0.05, 0.0)), bar_m=(0.17, 0.03),
            blur_px=self.blur_px, noise_grey=1e-6,
        )  # fmt: skip
        object.__setattr__(self, "scene", scene)

    def draw(
        self, turn_deg: float, rng: np.random.Generator, move_m: tuple[float, float] = (0.0, 0.0)
    ) -> Image:
        """Return the (H, W) uint8 image after a rotation, counter-clockwise as the camera sees it."""
        colour = self.scene.render(self._pose(turn_deg, move_m), rng)
        grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY).astype(np.float32)
        noisy = grey + rng.normal(0.0, self.noise_grey, grey.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def exact_corners(self, turn_deg: float, move_m: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """Return the true positions of the corners, (2, 4, 2) px."""
        return self.scene.exact_corners_px(self._pose(turn_deg, move_m))

    def _pose(self, turn_deg: float, move_m: tuple[float, float]) -> Pose:
        tilt = Rotation.from_euler("x", self.tilt_deg, degrees=True)
        turn = Rotation.from_euler("y", -turn_deg, degrees=True)
        distance = _FOCAL_PX * _SIDE_M / self.side_px
        return Pose.from_rotation((0.02 + move_m[0], 0.01 + move_m[1], distance), tilt * _FACING * turn)
