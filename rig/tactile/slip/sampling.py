"""The gradients of a frame, sharpened for the alignment."""

from functools import cached_property

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.slip.height import Box, Field, Gradient, within
from rig.tactile.slip.parameters import JOINT, SLOPES

# Broad slopes of a contact are less reliable than fine ones: the gel yields around the contact, the map has
# errors, and an arc that slides along itself keeps its outline. Therefore a part of the local mean is
# subtracted, with a window of this standard deviation and reach in pixels.
BROAD_PX, BROAD_REACH_PX = 2.0, 4


def sharpened(gradient: Gradient, broad_share: float) -> Gradient:
    """Return a gradient field (h, w) without a fraction of its broad part."""
    pairs = np.ascontiguousarray(gradient).view(np.float32).reshape(*gradient.shape, 2)
    side = 2 * BROAD_REACH_PX + 1
    broad = cv2.GaussianBlur(pairs, (side, side), BROAD_PX)
    return cv2.scaleAdd(broad, -broad_share, pairs).view(np.complex64)[..., 0]


class GradientField:
    """A frame's sharpened gradients inside its contact.

    gradient: (h, w). mask: (h, w) uint8, 1 in the contact. box: the part in which the gradient is not 0, by
    default all; it includes the reach of the sharpening around the contact. planes: (h, w, 3) float32, x and
    y of the gradients, and the mask.
    """

    def __init__(self, gradient: Gradient, mask: Image, box: Box | None = None) -> None:
        self.mask = mask
        self._gradient, self._inside = gradient, within(box, gradient.shape)
        self.planes = self._planes(SLOPES.broad_share)

    @cached_property
    def fine_planes(self) -> Field:
        """The same as `planes` with less of the broad part, for the joint tracker."""
        return self._planes(JOINT.broad_share)

    def _planes(self, broad_share: float) -> Field:
        planes = np.zeros((*self.mask.shape, 3), np.float32)
        planes[..., 2] = self.mask
        fine = sharpened(self._gradient[self._inside], broad_share)
        planes[*self._inside, 0], planes[*self._inside, 1] = fine.real, fine.imag
        return planes
