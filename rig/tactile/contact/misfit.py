"""Detect frames whose difference from the background is no contact.

The camera has been shifted, rows or columns are dead, or strong compression has left blocks of 8 x 8 pixels.
All of these stand still in the picture, and an estimator follows them as a contact that never turns. A shift
is recognised because it explains a frame better than the background in its place does, whatever touches the
gel; a dead line because all its pixels are alike; blocks because neighbours differ more at their borders.
"""

import math
from collections import deque

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.untouched import Comparison

REACH = 6
"""Largest shift that is searched, in pixels of the reduced copy: 24 px of a DIGIT's frame."""
PER_LOG, DARK = 2000.0, 15.0
"""Scale of the logarithms, which are compared as integers; grey levels added before, against dark noise."""
MOST_OFF = 0.06
"""Larger relative differences count as this much: a contact is not explained by a shift. Pixels that differ
by more in both places do not count at all."""
SOFT_PX = 0.8
"""Standard deviation of the blur of both pictures, in pixels of the reduced copy, against noise."""
EXPLAINED, LEAST_PX = 0.08, 1.5
"""Mean log ratio of the difference without and with the shift, and size of the shift in pixels of the frames,
from which on the background is shifted. With their own backgrounds, rotation_clips and real_turns have a
ratio of at most 0.045, and 18 SIMULATED lifts 0.006. Smaller shifts are not reported, although one of (1, 1)
px lowers the labels of 12 real clips within 3 degrees from 80 to 63 %."""
CHECKED, FEWEST = 20, 3
"""Number of newest frames whose mean counts, and fewest frames."""
FLAT, LIVELY = 3, 12
"""A line is dead if its values span at most FLAT grey levels, and at least LIVELY in the background."""

BLOCK_PX = 8
"""Side of a block of JPEG and of most video compression (ISO/IEC 10918-1)."""
BLOCKY, BLOCK_STEP = 3.0, 1.5
"""Mean difference of neighbouring pixels at the borders of blocks, over the one inside, and the excess in
grey levels, from which on blocks may hide a contact. Of 31 real clips with a ratio of 3 or more the excess is
at most 1.22 as published, 1.47 after JPEG quality 50, and at least 1.54 after quality 30, which made angles
of 3 of 19 clips confidently wrong. Two clips with dots, which blocks do not hide, have at most 2.4."""


class Misfit:
    """Collects evidence from frames with a contact that more than the contact differs from the background.

    background: (H, W, 3) uint8 RGB.
    """

    def __init__(self, background: Image, comparison: Comparison) -> None:
        self._comparison = comparison
        self._lively = [_span(background, axis) >= LIVELY for axis in (1, 0)]
        self._reduced = self._logarithm(background)
        self._px = background.shape[1] / self._reduced.shape[1], background.shape[0] / self._reduced.shape[0]
        self._shifts = deque[tuple[float, float, float]](maxlen=CHECKED)
        self._shifted_px: float | None = None
        self._dead = deque[tuple[int, int]](maxlen=FEWEST)
        self._blocks = deque[tuple[float, float]](maxlen=CHECKED)
        self.compressed = False
        """Whether the newest frames are compressed so strongly that blocks may hide a contact."""

    @property
    def text(self) -> str:
        """The reason why the frames have no angle, "" without one."""
        if self.compressed:
            return f"the images are so strongly compressed that blocks of {BLOCK_PX} pixels hide the contact"
        lines = zip(("rows", "columns"), self._dead_lines(), strict=True)
        what = [f"dead {name} ({count})" for name, count in lines if count]
        if self._shifted_px is not None:
            what.append(f"shifted by about {self._shifted_px:.0f} px")
        return f"the frames do not fit the background: {', '.join(what)}" if what else ""

    def add(self, image: Image) -> None:
        """Compare a frame with the background. image: (H, W, 3) uint8 RGB of its size."""
        rows, columns = (
            int(np.count_nonzero(lively & (_span(image, axis) <= FLAT)))
            for axis, lively in zip((1, 0), self._lively, strict=True)
        )
        self._dead.append((rows, columns))
        self._shifts.append(self._shift_of(image))
        x, y, explained = np.array(self._shifts).T
        # Not taken back later, because a contact that covers the gel hides most of what a shift explains.
        if len(explained) >= FEWEST and explained.mean() >= EXPLAINED:
            size_px = float(np.hypot(*np.average([x, y], axis=1, weights=explained)))
            if size_px >= LEAST_PX:
                self._shifted_px = size_px

    def add_blocks(self, image: Image) -> None:
        """Measure the blocks of a frame with or without contact. image: (H, W, 3) uint8 RGB."""
        self._blocks.append(_blocks(image))
        ratio, excess = np.median(self._blocks, axis=0)
        self.compressed = bool(len(self._blocks) >= FEWEST and ratio >= BLOCKY and excess >= BLOCK_STEP)

    def _dead_lines(self) -> tuple[int, int]:
        """Return the number of rows and of columns that were dead in all of the newest frames."""
        if len(self._dead) < FEWEST:
            return 0, 0
        return min(rows for rows, _ in self._dead), min(columns for _, columns in self._dead)

    def _shift_of(self, image: Image) -> tuple[float, float, float]:
        """Return the best shift, px, and the log ratio of the differences without and with it."""
        frame = self._logarithm(image)
        height, width = (side - 2 * REACH for side in frame.shape[:2])
        if min(height, width) < REACH:
            return 0.0, 0.0, 0.0
        core = frame[REACH:-REACH, REACH:-REACH]
        most = np.full(core.shape, MOST_OFF * PER_LOG, np.uint16)

        def off(background: MatLike, to: NDArray[np.uint16]) -> MatLike:
            cv2.absdiff(core, background, dst=to)
            return cv2.min(to, most, dst=to)

        moved, fixed = np.empty_like(core), np.empty_like(core)
        costs = np.empty((2 * REACH + 1, 2 * REACH + 1))
        for y, x in np.ndindex(costs.shape):
            costs[y, x] = cv2.norm(off(self._reduced[y : y + height, x : x + width], moved), cv2.NORM_L1)
        y, x = (int(place) for place in np.unravel_index(int(costs.argmin()), costs.shape))
        right, down = _valley(costs[y], x), _valley(costs[:, x], y)
        way = np.array([[1.0, 0.0, REACH + right], [0.0, 1.0, REACH + down]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        off(cv2.warpAffine(self._reduced, way, (width, height), flags=flags), moved)
        off(self._reduced[REACH:-REACH, REACH:-REACH], fixed)
        contact = np.all((fixed == most) & (moved == most), axis=2)
        seen = np.repeat((~contact).astype(np.uint8)[..., None], 3, axis=2)
        before, after = (1.0 + cv2.norm(one, cv2.NORM_L1, seen) for one in (fixed, moved))
        return right * self._px[0], down * self._px[1], math.log(before / after)

    def _logarithm(self, image: Image) -> NDArray[np.uint16]:
        """Return the logarithm of a frame's reduced copy in the light of the background, (h, w, 3)."""
        soft = cv2.GaussianBlur(self._comparison.lit(image), (0, 0), SOFT_PX)
        return np.rint(PER_LOG * np.log(np.clip(soft, 0.0, None) + DARK)).astype(np.uint16)


def _valley(costs: NDArray[np.float64], place: int) -> float:
    """Return the shift at the vertex of the parabola through a minimum and its neighbours, px."""
    if not 0 < place < len(costs) - 1:
        return float(place - REACH)
    before, here, after = costs[place - 1 : place + 2]
    bend = before + after - 2.0 * here
    return place - REACH + (0.5 * (before - after) / bend if bend > 0.0 else 0.0)


def _blocks(image: Image) -> tuple[float, float]:
    """Return the difference of neighbours at the borders of blocks over the one inside, and minus it.

    Both are 0 for a frame that is not larger than a block.
    """
    if min(image.shape[:2]) <= BLOCK_PX:
        return 0.0, 0.0
    green = cv2.extractChannel(image, 1)
    at_borders, inside = [], []
    for axis in (0, 1):
        later, earlier = (green[1:], green[:-1]) if axis == 0 else (green[:, 1:], green[:, :-1])
        steps = cv2.reduce(cv2.absdiff(later, earlier), 1 - axis, cv2.REDUCE_AVG, dtype=cv2.CV_64F).ravel()
        border = np.arange(1, len(steps) + 1) % BLOCK_PX == 0
        at_borders.append(steps[border].mean())
        inside.append(steps[~border].mean())
    border, within = float(np.mean(at_borders)), float(np.mean(inside))
    return border / max(within, 0.1), border - within


def _span(image: Image, axis: int) -> NDArray[np.uint8]:
    """Return the largest range of the three colours in each line along an axis, grey levels."""
    most, least = (cv2.reduce(image, axis, how) for how in (cv2.REDUCE_MAX, cv2.REDUCE_MIN))
    return np.asarray(cv2.subtract(most, least).reshape(-1, 3).max(axis=1), np.uint8)
