"""The slopes of a frame, sharpened for the alignment, and their curvature."""

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.slip.gradient import LearntGradientMap
from rig.tactile.slip.height import Box, Field
from rig.tactile.slip.pixels import divergence, without_broad

# Broad slopes of a contact are less reliable than fine ones: the gel yields around the contact, the map has
# errors, and an arc that slides along itself keeps its outline. Therefore a part of the local mean is
# subtracted, with a window of this standard deviation and reach in pixels.
BROAD_PX, BROAD_REACH_PX = 2.0, 4
# Plane of the curvature.
CURVATURE = 3
_SIDE = 2 * BROAD_REACH_PX + 1


def slope_planes(
    difference: Field, learnt: LearntGradientMap, mask: Image, box: Box, broad_share: float
) -> Field:
    """Return x and y of the sharpened slopes, the mask, and the curvature, in a box, (4, h, w) float32."""
    slopes = learnt.slopes(difference, box)
    broad = np.asarray(cv2.GaussianBlur(slopes, (_SIDE, _SIDE), BROAD_PX), np.float32)
    planes = np.empty((4, box[3], box[2]), np.float32)
    without_broad(slopes, broad, broad_share, mask, box[1], box[0], planes)
    divergence(slopes, planes[CURVATURE])
    return planes
