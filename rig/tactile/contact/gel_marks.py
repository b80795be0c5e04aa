"""Remove what stands still in the picture: specks, scratches and cuts of the gel, dust, hairs, dead pixels.

They do not move with the object. Under a contact they change sharply, and fit perfectly at their old
position, as if nothing had rotated. Therefore they are replaced by their surroundings in every frame. Marks
are visible in the background, or, if they came later, in the frames without contact, see `later_marks`.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from drivers.types import Image
from rig.tactile.contact.relative import DARK_OFFSET

# Standard deviations, px: marks are the difference to a blur by SHARP_PX; noise is reduced by NOISE_PX.
SHARP_PX, NOISE_PX = 4.0, 1.0
# Ratio of the change at a mark to that around it (median of a square this wide, px) and to that of the
# whole picture: streaks of light and a codec's blocks stay below.
TIMES_AROUND, TIMES_OVERALL, AROUND_PX = 3.5, 2.5, 25
# The same square for later marks: scratches may cross, and most of a smaller one would be scratched.
LATER_AROUND_PX = 61
# Pixels of which the median is taken then: every second one, in each direction, for speed.
LATER_STEP = 2
# Smallest change of a mark relative to the light: for a uniform background, and for marks that came later,
# above the noise of a codec.
LEAST_CHANGE, LEAST_LATER = 1e-3, 0.02
# Margin of a mark, of one that came later, width of the rim that it is filled from, number of the nearest
# pixels of the rim, standard deviation of the fill weights, px.
REACH_PX, LATER_PX, RIM_PX, NEAREST, FILL_PX = 3, 2, 3, 64, 2.5
# Ridge on the slope of the plane through the rim, because at the edge of the image the rim is on one side
# only.
LEVEL = 0.007
# Largest fraction of marks in the background, and with later ones. A background with more is patterned, and
# its marks are not filled.
MOST_SHARE, MOST_LATER = 0.05, 0.25
# Smaller weights of a rim are left out.
LEAST_WEIGHT = 1e-3
Field = NDArray[np.float32]
Places = NDArray[np.int32]
"""Rows and columns, (2, N)."""


class GelMarks:
    """The marks of one gel.

    marked: mask of the marks, (h, w), see `found_marks`. size: width and height of the differences.
    """

    def __init__(self, marked: Image, size: tuple[int, int]) -> None:
        inside = cv2.resize(marked, size, interpolation=cv2.INTER_AREA) > 0
        around = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
        rim = (cv2.dilate(inside.astype(np.uint8), around) > 0) & ~inside
        self._width, self._marked = size[0], np.flatnonzero(inside if rim.any() else rim)
        self._weights = _weights(self._marked, np.flatnonzero(rim), inside.shape)

    @property
    def table(self) -> tuple[Places, NDArray[np.int32], Places, Field]:
        """Return the places of the marks, where the rim of each begins, places of the rims, their weights."""
        of = self._weights
        marks, rims = (
            np.stack(np.divmod(found, self._width)).astype(np.int32) for found in (self._marked, of.indices)
        )
        return marks, np.asarray(of.indptr, np.int32), rims, np.asarray(of.data, np.float32)

    def fill(self, difference: Field) -> Field:
        """Return a difference (h, w, 3) with its marks filled from their surroundings."""
        if not len(self._marked):
            return difference
        pixels = difference.copy().reshape(-1, difference.shape[2])
        pixels[self._marked] = self._weights @ pixels
        return pixels.reshape(difference.shape)


def found_marks(background: Image, fine: tuple[int, int]) -> Image:
    """Return the mask of the marks in a background, (h, w), 255 or 0. fine: width and height of the mask."""
    light = cv2.resize(background.astype(np.float32), fine, interpolation=cv2.INTER_AREA)
    sharp = cv2.subtract(light, cv2.GaussianBlur(light, (0, 0), SHARP_PX)) / (light + DARK_OFFSET)
    return _sharp_mask(np.asarray(sharp, np.float32), AROUND_PX, 0.0, REACH_PX, MOST_SHARE, 1)


def find_later_marks(difference: Field) -> Image:
    """Return the mask of the marks in a relative difference (h, w, 3), which the background may not have."""
    sharp = cv2.subtract(difference, cv2.GaussianBlur(difference, (0, 0), SHARP_PX))
    return _sharp_mask(
        np.asarray(sharp, np.float32), LATER_AROUND_PX, LEAST_LATER, LATER_PX, MOST_LATER, LATER_STEP
    )


def _sharp_mask(
    sharp: Field, around_px: int, least: float, reach_px: int, most_share: float, step: int
) -> Image:
    """Return the mask of sharp places with a margin; empty if there are too many.

    step: the change around a place is the median of every `step`-th pixel of a square.
    """
    soft = cv2.GaussianBlur(sharp, (0, 0), NOISE_PX)
    across, down = (cv2.Scharr(soft, cv2.CV_32F, *axis, scale=1 / 32) for axis in ((1, 0), (0, 1)))
    squares = cv2.add(cv2.multiply(across, across), cv2.multiply(down, down))
    summed = cv2.blur(cv2.transform(squares, np.ones((1, 3))), (3, 3))
    change = np.sqrt(np.maximum(summed, np.float32(0.0)))
    overall = max(float(np.median(change[::step, ::step])), LEAST_CHANGE)
    levels = cv2.convertScaleAbs(change[::step, ::step], alpha=16.0 / overall)
    around = cv2.medianBlur(levels, around_px // step | 1).astype(np.float32) * np.float32(overall / 16.0)
    limit = np.maximum(TIMES_AROUND * around, max(TIMES_OVERALL * overall, least))
    size = change.shape[1], change.shape[0]
    marked = cv2.compare(change, cv2.resize(limit, size, interpolation=cv2.INTER_NEAREST), cv2.CMP_GT)
    reached = np.asarray(
        cv2.dilate(marked, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)), np.uint8
    )
    return np.zeros_like(reached) if cv2.countNonZero(reached) > most_share * reached.size else reached


def _weights(marked: NDArray[np.intp], rim: NDArray[np.intp], shape: tuple[int, ...]) -> csr_array:
    """Return the weights of the pixels for each marked pixel, (M, h w), from a fit of a plane to the rim.

    A mean of the neighbours would flatten the slope of a contact across a mark.
    """
    many = (len(marked), shape[0] * shape[1])
    if not len(marked):
        return csr_array(many, dtype=np.float32)
    places, rims = (np.stack(np.divmod(of, shape[1]), axis=1) / FILL_PX for of in (marked, rim))
    count = min(NEAREST, len(rim))
    near = np.reshape(KDTree(rims).query(places, count)[1], (-1, count))
    away = rims[near] - places[:, None]
    # Distances are relative to the nearest pixel, so that some weight remains.
    squares = (away**2).sum(axis=2)
    weight = np.exp((squares.min(axis=1, keepdims=True) - squares) / 2.0)
    plane = np.concatenate([np.ones((*near.shape, 1)), away], axis=2)
    weighted = plane * (weight / weight.sum(axis=1, keepdims=True))[..., None]
    normal = np.einsum("mri,mrj->mij", weighted, plane) + np.diag([0.0, LEVEL, LEVEL])
    at_mark = np.linalg.solve(normal, np.broadcast_to([[1.0], [0.0], [0.0]], (len(marked), 3, 1)))
    fill = np.einsum("mri,mij->mr", weighted, at_mark)
    fill *= np.abs(fill) > LEAST_WEIGHT
    fill /= np.maximum(fill.sum(axis=1, keepdims=True), 0.1)
    of = csr_array((fill.reshape(-1), rim[near].reshape(-1), np.arange(len(marked) + 1) * count), many)
    of.eliminate_zeros()
    return csr_array(of, dtype=np.float32)
