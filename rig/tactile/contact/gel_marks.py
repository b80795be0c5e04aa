"""Remove what stands still in the picture: specks, scratches and cuts of the gel, dust, hairs, dead pixels.

They do not move with the object. Under a contact they change sharply, and fit perfectly at their old
position, as if nothing had rotated. Therefore they are replaced by their surroundings in every frame. Marks
are visible in the background, or, if they came later, in the frames without contact.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.contact.relative import DARK_OFFSET, smoothed

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
# Largest fraction of a seeming contact that its marks cover: 0.2 to 0.5 for a hair, scratches and dust, 0.65
# and more for small sharp contacts (drawn).
MOST_COVERED = 0.6
# A seeming contact that its marks cover, and that keeps its area for this number of the first frames within
# this factor, is a mark if the region is larger by the second factor in this number of frames in a row: the
# contact has come then. A single larger frame may be torn.
STILL_FRAMES, STILL, OUTGROWN, GROWN_FRAMES = 5, 1.1, 1.5, 2
# Smaller weights of a rim are left out.
LEAST_WEIGHT = 1e-3
# Period of the search for later marks; number of searched frames that are averaged.
SEARCH_NS, AVERAGED = NS_PER_S // 4, 8
# Fraction of the marks that has to differ before they are filled otherwise.
NEWS_SHARE = 0.1
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

    def mended(self, difference: Field) -> Field:
        """Return a difference (h, w, 3) with its marks filled from their surroundings."""
        if not len(self._marked):
            return difference
        pixels = difference.copy().reshape(-1, difference.shape[2])
        pixels[self._marked] = self._weights @ pixels
        return pixels.reshape(difference.shape)


class LaterMarks:
    """Finds the marks that came after the background was taken, in frames without contact.

    marked: mask of the marks, (h, w), at first those of the background.
    """

    def __init__(self, marked: Image) -> None:
        self.marked = self._first = marked
        self._mean, self._averaged = np.zeros(0, np.float32), 0
        self._newest: Field | None = None
        self._touched = False
        self._searched_ns: int | None = None
        self._suspected: Image | None = None
        self._area_px = self._still = self._grown = 0

    @property
    def later(self) -> Image:
        """Mask of the marks that the background does not have, (h, w)."""
        return self.marked & ~self._first

    def touched(self) -> None:
        """Leave out the frames next to one with contact, in which a faint contact may be visible."""
        self._newest, self._touched = None, True

    def due(self, time_ns: int) -> bool:
        """Whether a frame should be searched; the next one is due after `SEARCH_NS`."""
        due = self._searched_ns is None or time_ns - self._searched_ns >= SEARCH_NS
        self._searched_ns = time_ns if due else self._searched_ns
        return due

    def explain(self, difference: Field, region: Region, first: bool) -> bool:
        """Whether a difference (h, w, 3) shows no contact if its marks are filled.

        region: of the seeming contact, in the work copy. The hull of marks is mostly empty. A region that is
        mostly covered counts as a contact; in the first frames its marks are stored for `confirmed`.
        """
        contact = region.mask
        size = contact.shape[1], contact.shape[0]
        marked = self._first | _later(difference)
        seeming = cv2.resize(contact, marked.shape[::-1], interpolation=cv2.INTER_NEAREST)
        covered = cv2.countNonZero(cv2.bitwise_and(marked, marked, mask=seeming))
        if covered > MOST_COVERED * cv2.countNonZero(seeming):
            if first:
                self._suspected, self._area_px = marked, region.area_px
            return False
        work = np.asarray(cv2.resize(difference, size, interpolation=cv2.INTER_AREA), np.float32)
        # The mean of the surroundings is enough here, and cheaper than a plane through them.
        clear = (cv2.resize(marked, size, interpolation=cv2.INTER_AREA) == 0).astype(np.float32)[..., None]
        sums = cv2.GaussianBlur(np.dstack([work * clear, clear]), (0, 0), FILL_PX)
        clean = np.where(clear > 0.0, work, sums[..., :3] / np.maximum(sums[..., 3:], 1e-3))
        return find_contact(smoothed(clean)) is None

    def confirmed(self, region: Region | None) -> bool:
        """Add the stored marks of the first frames if a contact has come beside them; return whether."""
        if self._suspected is None:
            return False
        growth = 0.0 if region is None else region.area_px / self._area_px
        still = 1.0 / STILL <= growth <= STILL
        self._still += still
        self._grown = self._grown + 1 if growth >= OUTGROWN else 0
        if growth < 1.0 / STILL or (self._still < STILL_FRAMES and not still):
            self._suspected = None
        if self._suspected is None or self._grown < GROWN_FRAMES:
            return False
        self.marked, self._suspected = self._suspected, None
        return True

    def add(self, difference: Field) -> bool:
        """Search a frame without contact; return whether the marks have changed.

        difference: relative, (h, w, 3), without filled marks.
        """
        before, self._newest = self._newest, None if self._touched else difference
        self._touched = False
        return before is not None and self._averaged_in(before)

    def _averaged_in(self, difference: Field) -> bool:
        self._averaged = min(self._averaged + 1, AVERAGED)
        mean = self._mean if self._averaged > 1 else difference
        self._mean = np.asarray(mean + (difference - mean) / self._averaged, np.float32)
        marked = self._first | _later(self._mean)
        news = cv2.countNonZero(marked ^ self.marked)
        if news <= NEWS_SHARE * cv2.countNonZero(marked | self.marked):
            return False
        self.marked = marked
        return True


def found_marks(background: Image, fine: tuple[int, int]) -> Image:
    """Return the mask of the marks in a background, (h, w), 255 or 0. fine: width and height of the mask."""
    light = cv2.resize(background.astype(np.float32), fine, interpolation=cv2.INTER_AREA)
    sharp = cv2.subtract(light, cv2.GaussianBlur(light, (0, 0), SHARP_PX)) / (light + DARK_OFFSET)
    return _marked(np.asarray(sharp, np.float32), AROUND_PX, 0.0, REACH_PX, MOST_SHARE, 1)


def _later(difference: Field) -> Image:
    """Return the mask of the marks in a relative difference (h, w, 3)."""
    sharp = cv2.subtract(difference, cv2.GaussianBlur(difference, (0, 0), SHARP_PX))
    return _marked(
        np.asarray(sharp, np.float32), LATER_AROUND_PX, LEAST_LATER, LATER_PX, MOST_LATER, LATER_STEP
    )


def _marked(sharp: Field, around_px: int, least: float, reach_px: int, most_share: float, step: int) -> Image:
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
