"""Presses of a ball found in tactile pictures: where, how wide; no circle is drawn by hand."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.gradient_map import colour_change
from calibration.gel.reference import check_frame
from drivers.types import Image

Array = NDArray[np.floating]

_LEAST_CHANGE_GREY = 10.0
_SHARE_OF_PEAK = 0.3
_SMALLEST_RADIUS_PX = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A ball's contact. change: (H, W, 3) colour change. strength: (H, W) grey levels it changed by.

    centre_px: (x, y). reach_px: radius of what changed. rim_px: radius at which the change falls off.
    """

    id: str
    change: NDArray[np.float32]
    strength: NDArray[np.float32]
    centre_px: tuple[float, float]
    reach_px: float
    rim_px: float


def find_press(image: Image, reference: NDArray[np.float32], name: str) -> Press | str:
    """Find the one round contact in a (H, W, 3) uint8 RGB picture, or say why there is none.

    Raises `CalibrationError` for a picture of another size, or one without light.
    """
    check_frame(image, name)
    change = colour_change(image, reference)
    grey = cv2.GaussianBlur(image.astype(np.float32) - reference, (0, 0), 2.0)
    strength = np.linalg.norm(grey, axis=2).astype(np.float32)
    bound = max(_LEAST_CHANGE_GREY, _SHARE_OF_PEAK * float(np.percentile(strength, 99.5)))
    outline = _outline(strength > bound)
    if outline is None:
        return f"no contact: nothing changed by more than {bound:.0f} grey"
    circle = _circle(outline, strength.shape)
    if circle is None:
        return "the contact is not round, or only a small part of it is in the picture"
    x, y, reach = circle
    if reach < _SMALLEST_RADIUS_PX:
        return f"the contact is {reach:.0f} px wide only: press harder"
    return Press(name, change, strength, (x, y), reach, rim_radius(strength, (x, y), reach))


def rim_radius(strength: Array, centre_px: tuple[float, float], reach_px: float) -> float:
    """Radius in px at which the change, averaged round the centre, falls off most steeply."""
    rows, columns = np.indices(strength.shape)
    distance = np.hypot(columns - centre_px[0], rows - centre_px[1])
    near = distance < 1.2 * reach_px
    ring = distance[near].astype(int)
    counts = np.bincount(ring)
    profile = np.bincount(ring, strength[near]) / np.maximum(counts, 1)
    smooth = np.convolve(np.pad(profile, 2, mode="edge"), np.full(5, 0.2), "valid")
    first, last = int(0.35 * reach_px), max(int(1.1 * reach_px), int(0.35 * reach_px) + 2)
    fall = -np.gradient(smooth)[first : min(last, len(smooth))]
    return float(first + np.argmax(fall)) if len(fall) else reach_px


def _outline(changed: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """(N, 2) px, the outline of the largest patch, small holes closed."""
    closed = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return None
    largest = max(outlines, key=cv2.contourArea).reshape(-1, 2)
    return largest.astype(np.int64) if len(largest) >= 12 else None


def _circle(outline: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[float, float, float] | None:
    """Circle (x, y, radius) through an outline, the picture's border left out (Kasa fit)."""
    x, y = outline.T
    inside = (x > 1) & (x < shape[1] - 2) & (y > 1) & (y < shape[0] - 2)
    points = outline[inside].astype(np.float64)
    if len(points) < 0.4 * len(outline) or len(points) < 12:
        return None
    middle = points.mean(axis=0)
    from_middle = points - middle
    system = np.column_stack([2.0 * from_middle, np.ones(len(points))])
    (cx, cy, rest), *_ = np.linalg.lstsq(system, (from_middle**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(rest + cx**2 + cy**2, 0.0)))
    off = np.abs(np.hypot(from_middle[:, 0] - cx, from_middle[:, 1] - cy) - radius)
    if radius <= 0.0 or float(np.median(off)) > 0.25 * radius:
        return None
    return float(middle[0] + cx), float(middle[1] + cy), radius
