"""Dark markers printed on a gel: where each has gone since a first frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivers.types import Image
from rig.tactile.contact.dots import Points, find_dots

# A marker is looked for within this share of the distance to its nearest neighbour.
STEP_SHARE = 0.45


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


def _steps(points: Points) -> NDArray[np.float64]:
    """How far each marker may move from one frame to the next, px."""
    if len(points) < 2:
        return np.zeros(len(points))
    return STEP_SHARE * np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
