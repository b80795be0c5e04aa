"""The calibrations a session uses: stored with its bench, so that a replay uses the same ones."""

import numpy as np
from pydantic import Field

from calibration.camera.model import CameraModel
from drivers.types import Pose
from rig.config.fields import Strict


class FileInUse(Strict):
    """A calibration file: where it was, its hash, when it was made, and its verdict then."""

    file: str
    sha256: str
    created: str
    verdict: str


class CameraInUse(Strict):
    """matrix: nine numbers, row by row, px. distortion: five or eight, OpenCV's order."""

    matrix: tuple[float, ...]
    distortion: tuple[float, ...]

    def camera_model(self, size_px: tuple[int, int]) -> CameraModel:
        """The camera, for pictures of the bench file's width and height (checked when it was found)."""
        return CameraModel(size_px, np.reshape(self.matrix, (3, 3)), np.array(self.distortion))


class PlaceInUse(Strict):
    """`base_T_camera`: position in m, quaternion xyzw."""

    position_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]

    def pose(self) -> Pose:
        """As a pose."""
        return Pose(self.position_m, self.quaternion_xyzw)


class CalibrationsInUse(Strict):
    """What was found beside the bench file and replaces its nominal numbers.

    files: by kind and serial. pixel_aspect, time_shift_s (added to a sensor's times): by serial.
    opening: pairs of counts and m while the fingers close, counts rising.
    """

    files: dict[str, FileInUse] = Field(default_factory=dict)
    camera: CameraInUse | None = None
    base_T_camera: PlaceInUse | None = None  # noqa: N815 - frame names keep their case
    pixel_aspect: dict[str, float] = Field(default_factory=dict)
    time_shift_s: dict[str, float] = Field(default_factory=dict)
    opening: tuple[tuple[float, float], ...] = ()

    def joined(self, other: "CalibrationsInUse") -> "CalibrationsInUse":
        """Return what either has; of what both have, the other's."""
        return CalibrationsInUse(
            files=self.files | other.files,
            camera=other.camera or self.camera,
            base_T_camera=other.base_T_camera or self.base_T_camera,
            pixel_aspect=self.pixel_aspect | other.pixel_aspect,
            time_shift_s=self.time_shift_s | other.time_shift_s,
            opening=other.opening or self.opening,
        )
