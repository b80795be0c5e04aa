"""Make the input of a segmentation network from a tactile frame.

`frame`: the image, scaled to 0..1, as in the paper (section III-A). `frame+difference`: the relative
difference from the frame without contact (`rig.tactile.contact.relative`), followed by the image. The
difference is similar for all sensors; the image shows the direction of the light.
"""

from enum import Enum

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.relative import RelativeDifference

Planes = NDArray[np.float32]

MOST_DIFFERENCE = 2.0
"""Relative differences are clipped to this: bright spots on a dark background are not stronger contacts."""
MIDDLE_GREY = 0.3
"""Subtracted from the image: approximately the mean of a DIGIT's frame on a scale of 0 to 1."""


class NetworkInput(Enum):
    """Kind of input of a network; the values are used in model cards."""

    FRAME = "frame"
    FRAME_AND_DIFFERENCE = "frame+difference"

    @property
    def channels(self) -> int:
        """Number of planes."""
        return 3 if self is NetworkInput.FRAME else 6


def frame_planes(image: Image, size: tuple[int, int]) -> Planes:
    """Return (3, h, w) float32, 0 to 1, from an (H, W, 3) uint8 RGB frame. size: (width, height) in px."""
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.transpose(2, 0, 1), np.float32) / np.float32(255.0)


def compared_planes(image: Image, reference: RelativeDifference) -> Planes:
    """Return (6, h, w) float32 from an (H, W, 3) uint8 RGB frame: the relative difference, then the image."""
    small = reference.reduced(image)
    planes = np.empty((6, *small.shape[:2]), np.float32)
    np.clip(reference.of(small).transpose(2, 0, 1), -MOST_DIFFERENCE, MOST_DIFFERENCE, out=planes[:3])
    np.multiply(small.transpose(2, 0, 1), np.float32(1.0 / 255.0), out=planes[3:])
    planes[3:] -= np.float32(MIDDLE_GREY)
    return planes
