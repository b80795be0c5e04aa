"""The slopes of a frame, sharpened for the alignment, and their curvature."""

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.slip.gradient import LearntGradientMap
from rig.tactile.slip.height import Box, Field, within

# Broad slopes of a contact are less reliable than fine ones: the gel yields around the contact, the map has
# errors, and an arc that slides along itself keeps its outline. Therefore a part of the local mean is
# subtracted, with a window of this standard deviation and reach in pixels.
BROAD_PX, BROAD_REACH_PX = 2.0, 4
# Plane of the curvature, which is the divergence of the slopes; 0 at the border of the box.
CURVATURE = 3
# Scale of Scharr's derivative, whose weights sum to 32 over a distance of one pixel.
SCHARR = 1.0 / 32.0
_SIDE = 2 * BROAD_REACH_PX + 1


def slope_planes(
    difference: Field, learnt: LearntGradientMap, mask: Image, box: Box, broad_share: float
) -> Field:
    """Return x and y of the sharpened slopes, the mask, and the curvature, in a box, (4, h, w) float32."""
    slopes = learnt.slopes(difference, box)
    broad = np.asarray(cv2.GaussianBlur(slopes, (_SIDE, _SIDE), BROAD_PX), np.float32)
    planes = np.zeros((4, box[3], box[2]), np.float32)
    planes[: CURVATURE - 1] = (slopes - np.float32(broad_share) * broad).transpose(2, 0, 1)
    planes[CURVATURE - 1] = mask[within(box)]
    along_x, along_y = (cv2.Scharr(slopes, cv2.CV_32F, dx, 1 - dx, scale=SCHARR) for dx in (1, 0))
    planes[CURVATURE, 1:-1, 1:-1] = (along_x[..., 0] + along_y[..., 1])[1:-1, 1:-1]
    return planes
