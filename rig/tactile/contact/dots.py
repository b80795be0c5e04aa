"""Dark dots printed on a gel: where they are, and what a frame would look like without them.

A gel is printed with dots so that its own motion can be seen: small dark blobs at regular distances, dark
in all three channels, as ink swallows every colour of light while a slope swallows one and reflects another.
They are no contact, and they move when the gel is pushed. So they are looked for in each frame anew, and
filled from what is around them.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivers.types import Image
from rig.tactile.sample import check_frame

# Markers are wider than noise and narrower than this share of the frame's short side: on a GelSight
# Mini (320 x 240) 12 to 20 px wide, 26 to 45 px apart.
REACH_SHARE = 0.10
# How much darker than its surroundings a marker is, as a share of them.
DARKER_SHARE = 0.25
# Area of a marker between these shares of the square that is looked through.
LEAST_AREA, MOST_AREA = 0.06, 0.8
# Below this grey level surroundings are too dark to show anything.
DARK_GREY = 12.0
# So many dots make a print. Dirt on a gel is fewer spots, or lies about at random: then the distance to the
# nearest neighbour differs from spot to spot by half of its mean, and that is half of what as many spots in
# rows and columns on the same area would have (Clark and Evans 1954: 1 at random, 2 on a square grid).
LEAST_DOTS, IRREGULAR, SPREAD = 12, 0.3, 1.6
# Whether there is a print is seen on a copy of this long side.
LOOKED_AT_PX = 640
# A dot's soft edge is filled too: this share of its width beside it. With more, more is lost of what turns.
MARGIN_SHARE, LEAST_MARGIN_PX = 0.15, 2
# What fills a dot is smooth: it is worked out on a copy reduced by so much.
REDUCED = 4

Points = NDArray[np.float64]


def find_dots(image: Image) -> Points:
    """Return the centres (N, 2) of the markers in an (H, W, 3) uint8 RGB frame: x right, y down, px.

    Those cut by the frame's edge are left out. Raises `InputError` for another shape or type.
    """
    check_frame(image)
    grey, around, side = _surroundings(image)
    darker = (around - grey) / np.maximum(around, DARK_GREY)
    spots = (darker > DARKER_SHARE).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
    weights = (darker * spots).ravel()
    rows, columns = np.indices(spots.shape)
    which = labels.ravel()
    total = np.maximum(np.bincount(which, weights, count), 1e-9)
    x = np.bincount(which, weights * columns.ravel(), count) / total
    y = np.bincount(which, weights * rows.ravel(), count) / total
    good = _complete(np.asarray(stats, np.int32), spots.shape, side)
    return np.column_stack([x, y])[good]


def without_markers(image: Image) -> Image:
    """Return the frame with what is dark and narrow filled from around it, channel by channel."""
    check_frame(image)
    return np.asarray(cv2.morphologyEx(image, cv2.MORPH_CLOSE, _square(image)), np.uint8)


def is_dotted(background: Image) -> bool:
    """Whether a frame without contact, (H, W, 3) uint8 RGB, is of a gel with printed dots."""
    check_frame(background)
    longest = max(background.shape[:2])
    if longest > LOOKED_AT_PX:
        size = [max(8, round(side * LOOKED_AT_PX / longest)) for side in background.shape[1::-1]]
        background = np.asarray(cv2.resize(background, size, interpolation=cv2.INTER_AREA), np.uint8)
    dots = find_dots(background)
    if len(dots) < LEAST_DOTS:
        return False
    nearest = np.asarray(KDTree(dots).query(dots, k=2)[0])[:, 1]
    spread = 2.0 * nearest.mean() * np.sqrt(len(dots) / max(float(np.ptp(dots, axis=0).prod()), 1.0))
    return bool(nearest.std() < IRREGULAR * nearest.mean() and spread > SPREAD)


def without_dots(image: Image) -> Image:
    """Return a frame whose dots are filled from what is around them, (H, W, 3) uint8 RGB.

    Also those that the frame's edge cuts. Raises `InputError` for another shape or type.
    """
    check_frame(image)
    spots, side = _spots(image)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
    labels, stats = np.asarray(labels, np.int32), np.asarray(stats, np.int32)
    small = (stats[:, 2] <= side) & (stats[:, 3] <= side)
    small[0] = False
    if not small.any():
        return image
    width_px = float(np.median(np.sqrt(stats[small, 4])))
    margin = max(LEAST_MARGIN_PX, round(MARGIN_SHARE * width_px))
    hidden = np.asarray(cv2.dilate(small[labels].astype(np.uint8), _disc(margin)), np.uint8)
    return _filled(image, hidden, width_px + 2 * margin)


def plain_of(background: Image) -> Callable[[Image], Image]:
    """Return what makes frames of this gel plain: it fills the dots of a dotted one, and nothing else."""
    return without_dots if is_dotted(background) else lambda image: image


def _filled(image: Image, hidden: Image, width_px: float) -> Image:
    """Fill what is hidden with the mean of what is near, weighted by a Gaussian as wide as a dot."""
    height, width = hidden.shape
    size = (max(1, width // REDUCED), max(1, height // REDUCED))
    kept = cv2.resize(cv2.copyTo(image, 1 - hidden), size, interpolation=cv2.INTER_AREA)
    share = cv2.resize((1 - hidden).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    sigma = max(0.5, 0.5 * width_px / REDUCED)
    near = cv2.GaussianBlur(kept.astype(np.float32), (0, 0), sigma)
    near /= np.maximum(cv2.GaussianBlur(share, (0, 0), sigma), 1e-3)[..., None]
    smooth = cv2.convertScaleAbs(cv2.resize(near, (width, height), interpolation=cv2.INTER_LINEAR))
    return np.asarray(cv2.copyTo(smooth, hidden, image.copy()), np.uint8)


def _spots(image: Image) -> tuple[NDArray[np.uint8], int]:
    """Return where a frame is darker than its surroundings, (H, W) 0 or 1, and the side of the square, px."""
    grey, around, side = _surroundings(image)
    return ((around - grey) > DARKER_SHARE * np.maximum(around, DARK_GREY)).astype(np.uint8), side


def _surroundings(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Return grey levels, what they are without markers, and the side of the square looked through, px.

    The brightest channel: coloured light leaves one dark where there is no marker, never all three.
    """
    red, green, blue = cv2.split(image)
    bright = cv2.GaussianBlur(cv2.max(cv2.max(red, green), blue), (0, 0), 1.0)
    square = _square(image)
    around = cv2.blur(cv2.morphologyEx(bright, cv2.MORPH_CLOSE, square), square.shape[::-1])
    return bright.astype(np.float32), around.astype(np.float32), len(square)


def _square(image: Image) -> NDArray[np.uint8]:
    side = max(round(REACH_SHARE * min(image.shape[:2])), 3) | 1
    return np.ones((side, side), np.uint8)


def _complete(stats: NDArray[np.int32], shape: tuple[int, ...], side: int) -> NDArray[np.bool_]:
    """Which components (label 0 is the rest) are whole markers: of their size, and off the edge."""
    left, top, width, height, area = stats.T
    inside = (left > 0) & (top > 0) & (left + width < shape[1]) & (top + height < shape[0])
    size = (area >= LEAST_AREA * side**2) & (area <= MOST_AREA * side**2)
    good = inside & size & (width <= side) & (height <= side)
    good[0] = False
    return good


def _disc(reach: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)
