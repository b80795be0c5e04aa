"""Contact masks: as polygons, as convex labels, and compared with one another.

The geometric ground truth of a simulated contact is the region where object and gel touch. A contact label is
the outline that a person would draw around the imprint. It is made from the geometric region in two steps:
gaps up to `CLOSE_SHARE` of the image's width are closed (ribs, weave, letters), and each connected part is
replaced by its convex hull. The reason is that manual labels of real frames are smooth convex outlines that
include rings and hollows. A margin can later move the outline outwards or inwards.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.measure import approximate_polygon, find_contours

from drivers.errors import InputError
from drivers.types import Image

Polygon = NDArray[np.float64]
"""(K, 2) corners x, y in pixels, from (0, 0) at the image's top left corner to (W, H). The centre of the
first pixel is (0.5, 0.5), as in LabelMe and COCO."""
TOLERANCE_PX = 0.4
"""Largest distance of a polygon from the mask's outline; a person cannot draw more accurately."""
LEAST_AREA_PX = 4.0
FINE = 4
"""Polygons are filled at this many times the resolution: OpenCV also fills the pixels on their border."""
MOST_FINE_PX = 5_000_000
"""Larger images are filled at their own resolution, to limit memory; border pixels matter little there."""
CLOSE_SHARE = 0.17
"""2.4 mm on the 14.4 mm wide gel of a DIGIT."""


def mask_polygons(mask: Image) -> list[Polygon]:
    """Return the outlines of the parts of a mask, (H, W) uint8, not 0 inside, largest first.

    Holes are ignored, because a contact has none.
    """
    inside = np.zeros(mask.shape, np.uint8)
    parts, _ = cv2.findContours((mask > 0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(inside, parts, -1, 1, cv2.FILLED)
    # The border of zeros closes outlines that touch the image's edge; 0.5 is the centre of a pixel.
    outlines = find_contours(np.pad(inside, 1).astype(np.float64), 0.5)
    polygons = [approximate_polygon(line, TOLERANCE_PX)[:-1, ::-1] - 0.5 for line in outlines]
    limit = np.array([mask.shape[1], mask.shape[0]], np.float64)
    clipped = [np.clip(polygon, 0.0, limit) for polygon in polygons if len(polygon) >= 3]
    return sorted((p for p in clipped if polygon_area(p) >= LEAST_AREA_PX), key=polygon_area, reverse=True)


def polygons_mask(polygons: list[Polygon], size: tuple[int, int]) -> Image:
    """Fill polygons into an (H, W) uint8 mask of 0 and 255. size: width and height, px."""
    finer = FINE if size[0] * size[1] <= MOST_FINE_PX else 1
    fine = np.zeros((finer * size[1], finer * size[0]), np.uint8)
    for polygon in polygons:
        cv2.fillPoly(fine, [np.rint(finer * polygon - 0.5).astype(np.int32)], 255)
    share = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    return np.where(share > 127, 255, 0).astype(np.uint8)


def polygon_area(polygon: Polygon) -> float:
    """Return a polygon's area, px^2 (shoelace formula)."""
    x, y = polygon[:, 0], polygon[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0)


def contact_label(touching: Image) -> Image:
    """Return the label, (H, W) uint8 0 or 255, of a geometric contact, (H, W), not 0 in the contact."""
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


@dataclass(frozen=True, slots=True)
class Agreement:
    """Dice and IoU of one mask with its label, 0 to 1; 1 if mask and label are empty."""

    dice: float
    iou: float


def agreement(mask: Image | None, label: Image) -> Agreement:
    """Compare a mask (None: no contact) with a label, both (H, W), not 0 inside. Raises `InputError`."""
    true = label > 0
    if mask is None:
        return Agreement(1.0, 1.0) if not true.any() else Agreement(0.0, 0.0)
    if mask.shape != label.shape:
        raise InputError(f"mask of shape {mask.shape} and label of shape {label.shape}: use one size")
    found = mask > 0
    both = int(np.count_nonzero(found & true))
    total = int(np.count_nonzero(found)) + int(np.count_nonzero(true))
    if total == 0:
        return Agreement(1.0, 1.0)
    return Agreement(2.0 * both / total, both / (total - both))
