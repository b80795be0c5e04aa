"""Detect frames whose difference from the background is no contact.

The camera has been shifted, the background is turned or mirrored, rows or columns are dead, or strong
compression has left blocks of 8 x 8 pixels. All of these stand still in the picture, and an estimator follows
them as a contact that never turns. A shift is recognised because it explains a frame better than the
background in its place does, whatever touches the gel, and a turned background likewise; a dead line because
all its pixels are alike; blocks because neighbours differ more at their borders.
"""

import math
from collections import deque
from collections.abc import Generator, Sequence
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.relative import Light
from rig.tactile.contact.untouched import Comparison

REACH = 6
"""Largest shift that is searched, in pixels of the reduced copy: 24 px of a DIGIT's frame."""
NEAR = tuple(product((-1, 0, 1), repeat=2))
"""Shifts to a place and its neighbours, down and right, px."""
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
TURNS = {"turned by 180 degrees": -1, "mirrored left to right": 1, "mirrored top to bottom": 0}
"""Ways in which a background can be stored wrong, with the code of `cv2.flip`."""
PATTERN_PX, TURNED = 40, 0.5
"""Sides of the copies whose correlation is compared. A background is turned or mirrored if its copy in that
way correlates better with the frames: mean log ratio of 1 - correlation, without and with it. Right
backgrounds of real_turns, the balls and the fakes have at most -0.59, turned or mirrored ones 0.6 or more."""
FLAT, LIVELY = 3, 12
"""A line is dead if its values span at most FLAT grey levels, and at least LIVELY in the background."""
LINE_PX = 83
"""Number of pixels that are read per row and column; a prime, so that they are at all places in a block."""

BLOCK_PX = 8
"""Side of a block of JPEG and of most video compression (ISO/IEC 10918-1)."""
BLOCKY, BLOCK_STEP = 3.0, 1.5
"""Mean difference of neighbouring pixels at the borders of blocks, over the one inside, and the excess in
grey levels, from which on blocks may hide a contact. Of 31 real clips with a ratio of 3 or more the excess is
at most 1.22 as published, 1.47 after JPEG quality 50, and at least 1.54 after quality 30, which made angles
of 3 of 19 clips confidently wrong. Two clips with dots, which blocks do not hide, have at most 2.4."""


FRAME_LINES, MOST_OF_OTHERS = 2, 1.25
"""Largest number of borders of blocks, in each direction, at which a picture has an edge for another reason,
as a black frame has whose width is n blocks. The mean counts as at most MOST_OF_OTHERS times that of the
others. Of compressed pictures it is at most 1.15 times it (real_turns, balls, JPEG quality 30 and 50)."""

Lines = tuple[Image, Image]
"""The rows and the columns of an image, (lines, px, 3) each, with at most `LINE_PX` pixels of each line."""


def lines_of(image: Image) -> Lines:
    """Return the rows and the columns of an image (H, W, 3) uint8."""
    height, width = image.shape[:2]
    sizes = (min(LINE_PX, width), height), (width, min(LINE_PX, height))
    rows, columns = (cv2.resize(image, size, interpolation=cv2.INTER_NEAREST) for size in sizes)
    return np.asarray(rows, np.uint8), np.asarray(cv2.transpose(columns), np.uint8)


class Misfit:
    """Collects evidence from frames with a contact that more than the contact differs from the background.

    background: (H, W, 3) uint8 RGB. comparison: of this background.
    """

    def __init__(self, background: Image, comparison: Comparison) -> None:
        self._lively = [_span(lines) >= LIVELY for lines in lines_of(background)]
        work = comparison.reduce(background)
        self._reduced = _logarithm(work, comparison.light(work))
        self._smaller = _smaller(self._reduced)
        self._px = background.shape[1] / self._reduced.shape[1], background.shape[0] / self._reduced.shape[0]
        pattern = _pattern(work)
        self._patterns = [pattern, *(cv2.flip(pattern, code) for code in TURNS.values())]
        self._turns = deque[list[float]](maxlen=CHECKED)
        self._turned = ""
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
        if self._turned:
            what.append(f"it is {self._turned}")
        elif self._shifted_px is not None:
            what.append(f"shifted by about {self._shifted_px:.0f} px")
        return f"the frames do not fit the background: {', '.join(what)}" if what else ""

    def add(self, lines: Lines, work: Image, light: Light) -> Generator[None, None, bool]:
        """Compare a frame with the background in two steps; return whether this frame does not fit.

        lines: from `lines_of`. work, light: the frame's reduced copy and light, see `Comparison`.
        """
        rows, columns = (
            int(np.count_nonzero(lively & (_span(of) <= FLAT)))
            for of, lively in zip(lines, self._lively, strict=True)
        )
        self._dead.append((rows, columns))
        seen = _pattern(work)
        own, *others = (1.001 - float((pattern * seen).sum()) for pattern in self._patterns)
        self._turns.append([math.log(own / other) for other in others])
        turned = np.mean(self._turns, axis=0)
        if len(self._turns) >= FEWEST and turned.max() >= TURNED:
            self._turned = list(TURNS)[int(turned.argmax())]
        self._shifts.append((yield from self._shift_of(_logarithm(work, light))))
        x, y, explained = np.array(self._shifts).T
        # Not taken back later, because a contact that covers the gel hides most of what a shift explains.
        if len(explained) >= FEWEST and explained.mean() >= EXPLAINED:
            size_px = float(np.hypot(*np.average([x, y], axis=1, weights=explained)))
            if size_px >= LEAST_PX:
                self._shifted_px = size_px
        return bool(rows or columns or explained[-1] >= EXPLAINED or max(self._turns[-1]) >= TURNED)

    def add_blocks(self, lines: Lines) -> bool:
        """Measure the blocks of a frame with or without contact; return whether they may hide a contact.

        lines: from `lines_of`.
        """
        self._blocks.append(_blocks(lines))
        self.compressed = len(self._blocks) >= FEWEST and _hides(*np.median(self._blocks, axis=0))
        return _hides(*self._blocks[-1])

    def _dead_lines(self) -> tuple[int, int]:
        """Return the number of rows and of columns that were dead in all of the newest frames."""
        if len(self._dead) < FEWEST:
            return 0, 0
        return min(rows for rows, _ in self._dead), min(columns for _, columns in self._dead)

    def _shift_of(self, frame: NDArray[np.uint16]) -> Generator[None, None, tuple[float, float, float]]:
        """Return the best shift, px, and the log ratio of the differences without and with it.

        frame: logarithm of its reduced copy. The shift is searched at a quarter and half of the size, and in
        the second step near the best place.
        """
        height, width = (side - 2 * REACH for side in frame.shape[:2])
        if min(height, width) < 2 * REACH:
            return 0.0, 0.0, 0.0
        down = right = 0
        for reach, small, background in zip((2, 4), _smaller(frame), self._smaller, strict=True):
            near = [(2 * down + y, 2 * right + x) for y, x in NEAR]
            down, right = near[int(np.argmin(_differences(small, background, reach, near)))]
        yield
        costs = np.full((2 * REACH + 1, 2 * REACH + 1), np.inf)
        y = x = 0
        for far in (1, 2):  # the second only if the best place is at the edge of the first
            rows, columns = (
                range(max(2 * at - far, -REACH), min(2 * at + far, REACH) + 1) for at in (down, right)
            )
            near = list(product(rows, columns))
            places = tuple(REACH + np.transpose(near))
            costs[places] = _differences(frame, self._reduced, REACH, near)
            y, x = (int(place) for place in np.unravel_index(int(costs.argmin()), costs.shape))
            if max(abs(y - REACH - 2 * down), abs(x - REACH - 2 * right)) < far:
                break
        to_right, to_bottom = _valley(costs[y], x), _valley(costs[:, x], y)
        way = np.array([[1.0, 0.0, REACH + to_right], [0.0, 1.0, REACH + to_bottom]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        shifted = cv2.warpAffine(self._reduced, way, (width, height), flags=flags)
        core, most = _core(frame, REACH)
        fixed = cv2.min(cv2.absdiff(core, self._reduced[REACH:-REACH, REACH:-REACH]), most)
        moved = cv2.min(cv2.absdiff(core, shifted), most)
        red, green, blue = cv2.split(cv2.min(fixed, moved))
        seen = np.less(cv2.min(cv2.min(red, green), blue), MOST_OFF * PER_LOG).astype(np.uint8)
        before, after = (1.0 + cv2.norm(one, cv2.NORM_L1, seen) for one in (fixed, moved))
        return to_right * self._px[0], to_bottom * self._px[1], math.log(before / after)


def _logarithm(work: Image, light: Light) -> NDArray[np.uint16]:
    """Return the logarithm of a frame's reduced copy in the light of the background, (h, w, 3)."""
    gain, offset = light
    lit = np.maximum((np.arange(256.0)[:, None] - offset) / gain, 0.0)
    levels = np.rint(PER_LOG * np.log(lit + DARK)).astype(np.uint16)
    return np.asarray(cv2.GaussianBlur(cv2.LUT(work, levels[None]), (0, 0), SOFT_PX), np.uint16)


def _pattern(work: Image) -> NDArray[np.float32]:
    """Return a small copy without its mean colour, of length 1, (`PATTERN_PX`, `PATTERN_PX`, 3)."""
    small = cv2.resize(work, (PATTERN_PX, PATTERN_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    small -= small.mean(axis=(0, 1))
    return np.asarray(small / max(float(np.linalg.norm(small)), 1e-6), np.float32)


def _smaller(logarithm: NDArray[np.uint16]) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return copies of a quarter and of half the size."""
    height, width = logarithm.shape[:2]
    half = cv2.resize(logarithm, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    quarter = cv2.resize(half, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    return np.asarray(quarter, np.uint16), np.asarray(half, np.uint16)


def _core(frame: NDArray[np.uint16], reach: int) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return the part of a frame that any shift leaves inside, and the largest difference that counts."""
    core = frame[reach:-reach, reach:-reach]
    return core, np.full(core.shape, MOST_OFF * PER_LOG, np.uint16)


def _differences(
    frame: NDArray[np.uint16],
    background: NDArray[np.uint16],
    reach: int,
    shifts: Sequence[tuple[int, ...]],
) -> list[float]:
    """Return the sum of the differences at each shift of the background, down and right, up to `reach` px."""
    core, most = _core(frame, reach)
    (height, width), off = core.shape[:2], np.empty_like(core)
    found = []
    for y, x in shifts:
        top, left = reach + y, reach + x
        cv2.absdiff(core, background[top : top + height, left : left + width], dst=off)
        found.append(cv2.norm(cv2.min(off, most, dst=off), cv2.NORM_L1))
    return found


def _valley(costs: NDArray[np.float64], place: int) -> float:
    """Return the shift at the vertex of the parabola through a minimum and its neighbours, px."""
    if not 0 < place < len(costs) - 1:
        return float(place - REACH)
    before, here, after = costs[place - 1 : place + 2]
    bend = before + after - 2.0 * here
    return place - REACH + (0.5 * (before - after) / bend if 0.0 < bend < np.inf else 0.0)


def _blocks(lines: Lines) -> tuple[float, float]:
    """Return the difference of neighbours at the borders of blocks over the one inside, and minus it.

    Both are 0 for a frame that is not larger than a block.
    """
    if min(map(len, lines)) <= BLOCK_PX:
        return 0.0, 0.0
    at_borders, inside = [], []
    for of in lines:
        green = cv2.extractChannel(of, 1)
        steps = cv2.reduce(cv2.absdiff(green[1:], green[:-1]), 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel()
        at_border = np.sort(steps[BLOCK_PX - 1 :: BLOCK_PX])
        others = at_border[: max(len(at_border) - FRAME_LINES, 1)]
        at_borders.append(min(at_border.mean(), MOST_OF_OTHERS * others.mean()))
        inside.append((steps.sum() - at_border.sum()) / (len(steps) - len(at_border)))
    border, within = float(np.mean(at_borders)), float(np.mean(inside))
    return border / max(within, 0.1), border - within


def _hides(ratio: float, excess: float) -> bool:
    """Return whether blocks with these values of `_blocks` may hide a contact."""
    return bool(ratio >= BLOCKY and excess >= BLOCK_STEP)


def _span(lines: Image) -> NDArray[np.uint8]:
    """Return the largest range of the three colours in each line (lines, px, 3), grey levels."""
    most, least = (cv2.reduce(lines, 1, how) for how in (cv2.REDUCE_MAX, cv2.REDUCE_MIN))
    return np.asarray(cv2.subtract(most, least).reshape(-1, 3).max(axis=1), np.uint8)
