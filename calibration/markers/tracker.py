"""Track two ArUco markers from picture to picture, searching where they are expected.

Searching the whole picture takes several times as long, and may find copies of a marker elsewhere. It is done
only to find the markers first, and to find them again.
"""

from collections.abc import Callable

import numpy as np

from calibration.targets.aruco import (
    Corners,
    Refusal,
    detect_all,
    detector,
    mean_side,
    refine_quick,
    region_detector,
    side_lengths,
)
from drivers.errors import InputError
from drivers.types import Image

Refine = Callable[[Image, Corners], Corners | Refusal]
"""Refines (M, 4, 2) px corners in a (H, W) uint8 picture to sub-pixel accuracy."""

SMALLEST_SIDE_PX = 16.0
"""Smallest side of a marker that is measured."""
FORGET_AFTER_FRAMES = 10
"""After this many frames without the markers, the last position is no longer used."""
_REGION_MARGIN = 0.35
"""Margin of the search region, as a fraction of the marker's side."""


class MarkerTracker:
    """Tracks two markers of one dictionary through the pictures of one camera.

    ids: the two marker ids, in the order of the result. dictionary: OpenCV's name, such as "DICT_4X4_50".
    refine: another corner refinement, for comparison.
    The same pictures in the same order give bitwise the same results. Raises `InputError` for equal ids or an
    unknown dictionary.
    """

    def __init__(
        self, ids: tuple[int, int], dictionary: str = "DICT_4X4_50", refine: Refine = refine_quick
    ) -> None:
        if ids[0] == ids[1]:
            raise InputError(f"markers: two different ids are needed, got {ids}")
        self._ids, self._refine = ids, refine
        self._full = detector(dictionary)
        self._near = region_detector(dictionary)
        self._size: tuple[int, ...] | None = None
        self.forget()

    def forget(self) -> None:
        """Search the whole next picture, for example after a pause."""
        self._last: Corners | None = None
        self._motion = np.zeros((2, 4, 2))
        self._missed = 0

    def detect(self, gray: Image) -> Corners | Refusal:
        """Find both markers in a (H, W) uint8 picture: (2, 4, 2) px corners in the order of the ids.

        Each marker's corners are clockwise from its own top left. Raises `InputError` for another shape or
        type, and if the size changes between pictures.
        """
        if gray.ndim != 2 or gray.dtype != np.uint8:
            raise InputError(f"markers: a (H, W) uint8 picture is needed, got {gray.shape} {gray.dtype}")
        if self._size is not None and gray.shape != self._size:
            raise InputError(f"markers: picture size changed from {self._size} to {gray.shape}; start again")
        self._size = gray.shape
        found = self._search(gray)
        if not isinstance(found, Refusal):
            found = self._refine(gray, found)
        if isinstance(found, Refusal):
            self._missed += 1
            self._motion[...] = 0.0
            if self._missed >= FORGET_AFTER_FRAMES:
                self.forget()
        else:
            if self._last is not None and self._missed == 0:
                limit = 0.5 * mean_side(found)
                self._motion = np.clip(found - self._last, -limit, limit)
            self._last, self._missed = found, 0
        return found

    def _search(self, gray: Image) -> Corners | Refusal:
        expected = None if self._last is None else self._last + self._motion
        if expected is not None:
            found = self._search_regions(gray, expected)
            if not isinstance(found, Refusal):
                return found
        places = (None, None) if expected is None else expected
        seen = detect_all(self._full, gray)
        found = _pair([_choose(seen.get(i, []), place) for i, place in zip(self._ids, places, strict=True)])
        if isinstance(found, Refusal) or expected is None:
            return found
        moved = np.linalg.norm(found - expected, axis=-1).max()
        return Refusal.JUMP if moved > mean_side(expected) * (1 + self._missed) else found

    def _search_regions(self, gray: Image, expected: Corners) -> Corners | Refusal:
        quads = []
        for marker_id, place, motion in zip(self._ids, expected, self._motion, strict=True):
            margin = float(_REGION_MARGIN * mean_side(place) + np.abs(motion).max())
            low = np.maximum(np.floor(place.min(axis=0) - margin).astype(int), 0)
            high = np.minimum(np.ceil(place.max(axis=0) + margin).astype(int) + 1, gray.shape[::-1])
            if (high - low < SMALLEST_SIDE_PX).any():
                return Refusal.NOT_FOUND
            window = np.s_[low[1] : high[1], low[0] : high[0]]
            seen = detect_all(self._near, gray[window]).get(marker_id, [])
            offset = (window[1].start, window[0].start)
            quads.append(_choose([quad + offset for quad in seen], place))
        return _pair(quads)


def _choose(quads: list[Corners], place: Corners | None) -> Corners | Refusal:
    """Return the only quad, or the one clearly nearest to the expected position."""
    if not quads:
        return Refusal.NOT_FOUND
    if len(quads) == 1:
        return quads[0]
    if place is None:
        return Refusal.DUPLICATE
    near, far = sorted(float(np.linalg.norm(quad - place)) for quad in quads)[:2]
    if near > 0.5 * far:
        return Refusal.DUPLICATE
    return min(quads, key=lambda quad: float(np.linalg.norm(quad - place)))


def _pair(quads: list[Corners | Refusal]) -> Corners | Refusal:
    """Return both markers as one array, if both were found and have similar sizes."""
    reasons = [quad for quad in quads if isinstance(quad, Refusal)]
    if Refusal.DUPLICATE in reasons:
        return Refusal.DUPLICATE
    if reasons:
        return Refusal.NOT_FOUND if len(reasons) == 2 else Refusal.ONE_HIDDEN
    corners = np.array(quads)
    first, second = side_lengths(corners).mean(axis=1)
    if min(first, second) < SMALLEST_SIDE_PX:
        return Refusal.TOO_SMALL
    return corners if 0.6 < first / second < 1.6 else Refusal.UNEQUAL
