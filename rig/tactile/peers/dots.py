"""Dark markers printed on a gel: where they are in a frame, and where each has gone since a first one."""

from dataclasses import dataclass

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
# A marker is looked for within this share of the distance to its nearest neighbour.
STEP_SHARE = 0.45

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


@dataclass(frozen=True, slots=True, eq=False)
class MarkerMotion:
    """Markers (N, 2) in the first frame and now, px; `seen` (N,) says which were found in this frame."""

    first_px: Points
    now_px: Points
    seen: NDArray[np.bool_]


class DotTracker:
    """Follows the markers of a first frame from frame to frame; a lost one is found where it was lost.

    image: (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type.
    """

    def __init__(self, image: Image) -> None:
        self._first = find_dots(image)
        self._now = self._first.copy()
        self._step = _steps(self._first)

    @property
    def first_px(self) -> Points:
        """The markers (N, 2) of the first frame."""
        return self._first

    def update(self, image: Image) -> MarkerMotion:
        """Find the markers in the next frame, (H, W, 3) uint8 RGB. Raises `InputError` as the first."""
        found = find_dots(image)
        seen = np.zeros(len(self._now), bool)
        if len(found) and len(self._now):
            far, nearest = map(np.asarray, KDTree(found).query(self._now))
            back = np.asarray(KDTree(self._now).query(found)[1])
            # Both ways nearest: two markers never become one.
            seen = (far <= self._step) & (back[nearest] == np.arange(len(self._now)))
            self._now[seen] = found[nearest[seen]]
        return MarkerMotion(self._first, self._now.copy(), seen)


def _surroundings(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Return grey levels, what they are without markers, and the side of the square looked through, px.

    The brightest channel: coloured light leaves one dark where there is no marker, never all three.
    """
    bright = cv2.GaussianBlur(image.max(axis=2), (0, 0), 1.0)
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


def _steps(points: Points) -> NDArray[np.float64]:
    """How far each marker may move from one frame to the next, px."""
    if len(points) < 2:
        return np.zeros(len(points))
    return STEP_SHARE * np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
