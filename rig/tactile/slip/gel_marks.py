"""Remove specks, scratches and cuts of the gel, which are visible in the background.

They do not move with the object. Under a contact they change sharply, and fit perfectly at their old
position, as if nothing had rotated. Therefore they are replaced by their surroundings in every frame.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from drivers.types import Image
from rig.tactile.contact.relative import DARK_OFFSET
from rig.tactile.slip.height import Field
from rig.tactile.slip.texture import FINE_PX, NOISE_PX

# Ratio of the change at a mark to that around it (median of a square this wide, px) and to that of the
# whole background: streaks of light and a codec's blocks stay below.
TIMES_AROUND, TIMES_OVERALL, AROUND_PX = 3.5, 2.5, 25
# Smallest change of a mark relative to the light, also for a uniform background.
LEAST_CHANGE = 1e-3
# Margin of a mark, width of the rim that it is filled from, standard deviation of the fill weights, px.
REACH_PX, RIM_PX, FILL_PX = 3, 3, 2.5
# Ridge on the slope of the plane through the rim, because at the edge of the image the rim is on one side
# only.
LEVEL = 0.01
# Largest fraction of marks in the background. A gel with more is patterned, and its marks are not filled.
MOST_SHARE = 0.05
# Smaller weights of a rim are left out of the compiled loop.
LEAST_WEIGHT = 2e-3
Places = NDArray[np.int32]
"""Rows and columns, (2, N)."""


class GelMarks:
    """The marks of one gel.

    marked: mask of the marks, (h, w), see `found_marks`. size: width and height of the differences.
    """

    def __init__(self, marked: Image, size: tuple[int, int]) -> None:
        inside = cv2.resize(marked, size, interpolation=cv2.INTER_AREA) > 0
        rim = cv2.dilate(inside.astype(np.uint8), np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)) > 0
        self._width = size[0]
        self._marked, self._rim = np.flatnonzero(inside), np.flatnonzero(rim & ~inside)
        weights = _weights(self._marked, self._rim, size[0])
        # Negligible weights are dropped, because a dense product takes ten times as long.
        self._weights = csr_array(weights * (np.abs(weights) > np.finfo(np.float32).eps))

    @property
    def table(self) -> tuple[Places, NDArray[np.int32], Places, NDArray[np.float32]]:
        """Return the places of the marks, where the rim of each begins, places of the rims, their weights."""
        of, width = self._weights, self._width
        heavy = csr_array(of.multiply(abs(of) > LEAST_WEIGHT))
        places = (
            np.stack(np.divmod(found, width)).astype(np.int32)
            for found in (self._marked, self._rim[heavy.indices])
        )
        marks, rims = places
        sums = np.maximum(np.asarray(heavy.sum(axis=1)).reshape(-1), np.float32(0.1))
        data = heavy.data / np.repeat(sums, np.diff(heavy.indptr))
        return marks, heavy.indptr.astype(np.int32), rims, data.astype(np.float32)

    def mended(self, difference: Field) -> Field:
        """Return a difference (h, w, 3) with its marks filled from their surroundings."""
        if not len(self._marked):
            return difference
        pixels = difference.copy().reshape(-1, difference.shape[2])
        pixels[self._marked] = self._weights @ pixels[self._rim]
        return pixels.reshape(difference.shape)


def found_marks(background: Image, fine: tuple[int, int]) -> Image:
    """Return the mask of the marks in a background, (h, w), 255 or 0. fine: width and height of the mask."""
    light = cv2.resize(background.astype(np.float32), fine, interpolation=cv2.INTER_AREA)
    sharp = cv2.subtract(light, cv2.GaussianBlur(light, (0, 0), FINE_PX)) / (light + DARK_OFFSET)
    sharp = cv2.GaussianBlur(sharp, (0, 0), NOISE_PX)
    slopes = [cv2.Scharr(sharp, cv2.CV_32F, *axis, scale=1 / 32) for axis in ((1, 0), (0, 1))]
    squares = np.sum(np.square(slopes), axis=(0, 3))
    change = np.sqrt(np.maximum(cv2.blur(squares, (3, 3)), np.float32(0.0)))
    overall = max(float(np.median(change)), LEAST_CHANGE)
    levels = np.clip(change * (16.0 / overall), 0, 255).astype(np.uint8)
    around = cv2.medianBlur(levels, AROUND_PX).astype(np.float32) * (overall / 16.0)
    marked = (change > TIMES_AROUND * around) & (change > TIMES_OVERALL * overall)
    reach = np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), np.uint8)
    reached = np.asarray(cv2.dilate(255 * marked.astype(np.uint8), reach), np.uint8)
    return np.zeros_like(reached) if np.count_nonzero(reached) > MOST_SHARE * reached.size else reached


def _weights(marked: NDArray[np.intp], rim: NDArray[np.intp], width: int) -> NDArray[np.float32]:
    """Return the weight of each pixel of the rim for each marked pixel, (M, R), from a local fit of a plane.

    A mean of the neighbours would flatten the slope of a contact across a mark.
    """
    down, across = (
        np.subtract.outer(one.astype(np.float64), other.astype(np.float64)) / FILL_PX
        for one, other in zip(divmod(marked, width), divmod(rim, width), strict=True)
    )
    # Distances are relative to the nearest pixel, so that some weight remains.
    squares = down**2 + across**2
    near = np.exp((squares.min(axis=1, keepdims=True, initial=np.inf) - squares) / 2.0)
    plane = np.stack([np.ones_like(down), down, across], axis=2)
    weighted = plane * (near / near.sum(axis=1, keepdims=True))[..., None]
    normal = np.einsum("mri,mrj->mij", weighted, plane) + np.diag([0.0, LEVEL, LEVEL])
    at_mark = np.linalg.solve(normal, np.broadcast_to([[1.0], [0.0], [0.0]], (len(marked), 3, 1)))
    return np.asarray(np.einsum("mri,mij->mr", weighted, at_mark), np.float32)
