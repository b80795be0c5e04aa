"""Finding the contact of a pressed ball in a tactile picture: its centre and its width."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.gradient_map import colour_change
from calibration.gel.reference import check_light
from drivers.types import Image

Array = NDArray[np.floating]

_LEAST_CHANGE_GREY = 10.0
_SHARE_OF_PEAK = 0.3
_SMALLEST_RADIUS_PX = 8.0
_RIM_ROUNDS = 3
_RIM_RAYS = 180
_RIM_WIDTH_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A ball's contact. change: (H, W, 3) colour change. strength: (H, W), its size in grey levels.

    centre_px: (x, y). reach_px: radius of the changed area. rim_px: radius where the change falls most
    steeply.
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
    check_light(image, name)
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
    """Radius in px at which the change, averaged around the centre, falls most steeply."""
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


def rim_centre(press: Press) -> tuple[float, float]:
    """Centre of a contact (x, y) px, from its rim, where the change falls most steeply.

    The brightness of a slope depends on the light and on the place; its edge does not. So this centre
    follows the contact alone, as the centre of the bright area does not.
    """
    (x, y), reach = press.centre_px, press.reach_px
    for _ in range(_RIM_ROUNDS):
        angle = np.linspace(0.0, 2.0 * np.pi, _RIM_RAYS, endpoint=False)[:, None]
        radius = np.arange(0.55 * reach, 1.3 * reach, 0.5)
        rays = np.stack([x + np.cos(angle) * radius, y + np.sin(angle) * radius], axis=-1)
        values = cv2.remap(press.strength, rays.astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        edge = _steepest(np.maximum(-np.diff(values, axis=1), 0.0), (radius[1:] + radius[:-1]) / 2.0)
        points = np.column_stack([x + np.cos(angle[:, 0]) * edge, y + np.sin(angle[:, 0]) * edge])
        (x, y), reach = _robust_circle(points, press.strength.shape)
    return x, y


def _steepest(fall: Array, middle: Array) -> Array:
    """(N,) radius of the steepest fall along each ray: the centroid of the fall around its maximum."""
    top = middle[fall.argmax(axis=1)]
    weight = fall * (np.abs(middle - top[:, None]) < _RIM_WIDTH_PX)
    return (weight * middle).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)


def _robust_circle(points: Array, shape: tuple[int, ...]) -> tuple[tuple[float, float], float]:
    """Circle through the points inside the picture, outliers left out iteratively."""
    inside = (points > 2.0).all(axis=1) & (points < np.subtract(shape[::-1], 3.0)).all(axis=1)
    x, y, radius = circle_through(points[inside])
    for _ in range(_RIM_ROUNDS):
        off = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius)
        inside &= off < max(3.0 * float(np.median(off[inside])), 0.7)
        x, y, radius = circle_through(points[inside])
    return (x, y), radius


def circle_through(points: Array) -> tuple[float, float, float]:
    """Circle (x, y, radius) closest to (N, 2) points (Kasa fit: linear least squares)."""
    middle = points.mean(axis=0)
    from_middle = points - middle
    system = np.column_stack([2.0 * from_middle, np.ones(len(points))])
    (cx, cy, rest), *_ = np.linalg.lstsq(system, (from_middle**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(rest + cx**2 + cy**2, 0.0)))
    return float(middle[0] + cx), float(middle[1] + cy), radius


def _outline(changed: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """(N, 2) px, the outline of the largest region, small holes closed."""
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
    cx, cy, radius = circle_through(points)
    off = np.abs(np.hypot(points[:, 0] - cx, points[:, 1] - cy) - radius)
    if radius <= 0.0 or float(np.median(off)) > 0.25 * radius:
        return None
    return cx, cy, radius
