"""The gradients of a frame, sharpened for the alignment."""

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.slip.height import Box, Gradient, within
from rig.tactile.slip.parameters import SLOPES

# Broad slopes of a contact are less reliable than fine ones: the gel yields around the contact, the map has
# errors, and an arc that slides along itself keeps its outline. Therefore a part of the local mean is
# subtracted, with a window of this standard deviation and reach in pixels.
BROAD_PX, BROAD_REACH_PX = 2.0, 4


def sharpened(gradient: Gradient) -> Gradient:
    """Return a gradient field (h, w) with its broad part attenuated."""
    pairs = np.ascontiguousarray(gradient).view(np.float32).reshape(*gradient.shape, 2)
    side = 2 * BROAD_REACH_PX + 1
    broad = cv2.GaussianBlur(pairs, (side, side), BROAD_PX)
    return cv2.scaleAdd(broad, -SLOPES.broad_share, pairs).view(np.complex64)[..., 0]


class GradientField:
    """A frame's sharpened gradients inside its contact.

    gradient: (h, w). mask: (h, w) uint8, 1 in the contact. box: the part in which the gradient is not 0, by
    default all; it includes the reach of the sharpening around the contact. planes: (h, w, 3) float32, x and
    y of the gradients, and the mask.
    """

    def __init__(self, gradient: Gradient, mask: Image, box: Box | None = None) -> None:
        self.mask = mask
        self.planes = np.zeros((*mask.shape, 3), np.float32)
        self.planes[..., 2] = mask
        inside = within(box, gradient.shape)
        fine = sharpened(gradient[inside])
        self.planes[*inside, 0], self.planes[*inside, 1] = fine.real, fine.imag
