"""Track the dark markers printed on a gel from a first frame on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivers.types import Image
from rig.tactile.contact.dots import Points, find_dots

# Search radius of a marker as a fraction of the distance to its nearest neighbour.
STEP_SHARE = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class MarkerMotion:
    """Positions (N, 2) of the markers in the first and in this frame, px; seen: (N,), found in this frame."""

    first_px: Points
    now_px: Points
    seen: NDArray[np.bool_]


class DotTracker:
    """Tracks the markers of a first frame from frame to frame.

    A marker that is lost can be found again near its last position. image: first frame, (H, W, 3) uint8 RGB.
    Raises `InputError` for another shape or type.
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
        """Find the markers in the next frame, (H, W, 3) uint8 RGB. Raises `InputError`."""
        found = find_dots(image)
        seen = np.zeros(len(self._now), bool)
        if len(found) and len(self._now):
            far, nearest = map(np.asarray, KDTree(found).query(self._now))
            back = np.asarray(KDTree(self._now).query(found)[1])
            # Mutual nearest neighbours only, so that two markers are never matched to the same spot.
            seen = (far <= self._step) & (back[nearest] == np.arange(len(self._now)))
            self._now[seen] = found[nearest[seen]]
        return MarkerMotion(self._first, self._now.copy(), seen)


def _steps(points: Points) -> NDArray[np.float64]:
    """Return the largest distance that each marker may move between two frames, px."""
    if len(points) < 2:
        return np.zeros(len(points))
    return STEP_SHARE * np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
