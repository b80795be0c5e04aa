"""What a contact label is: the region a person would draw round an imprint.

The geometric truth of a simulated contact is where object and gel touch. A label is that region
with gaps up to `CLOSE_SHARE` of the image's width closed (ribs, weave, letters), and each connected part
replaced by its convex hull: human labels of real frames are smooth convex outlines that enclose
rings and hollows. How much looser or tighter a mask should be is one parameter, the margin, by which
an outline is moved at the end.
"""

import cv2
import numpy as np

from drivers.types import Image

CLOSE_SHARE = 0.17
"""2.4 mm on the 14.4 mm wide gel of a DIGIT."""


def contact_label(touching: Image) -> Image:
    """Return the label of a geometric contact, (H, W) uint8 0 or 255 from (H, W), not 0 where touching."""
    reach = max(1, round(CLOSE_SHARE * touching.shape[1])) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    touched = (touching > 0).astype(np.uint8)
    padded = cv2.copyMakeBorder(touched, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach]
    label = np.zeros(touching.shape, np.uint8)
    parts, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for part in parts:
        cv2.fillConvexPoly(label, cv2.convexHull(part), 255)
    return label
