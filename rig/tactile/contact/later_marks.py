"""Find the marks that came after the background was taken: specks, hairs, and what an object has left."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Image
from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.contact.gel_marks import FILL_PX, find_later_marks
from rig.tactile.contact.relative import smooth

WEAK_SHARE = 0.5
"""A contact that falls below this fraction of its largest strength times area may have ended."""
MOST_COVERED = 0.6
"""Largest fraction of a seeming contact that its marks cover: 0.2 to 0.5 for a hair, scratches and dust, 0.65
and more for small sharp contacts (drawn)."""
STILL_S, STILL_FRAMES, STILL = 0.08, 2, 1.1
"""A seeming contact that its marks cover may be a mark if it keeps its area, within the last factor, for this
time and in this number of further frames."""
OUTGROWN, GROWN_FRAMES = 1.5, 2
"""It is a mark if a region that is larger by this factor, in this number of frames in a row, has come beside
it. A single larger frame may be torn."""
SEARCH_NS, AVERAGED = NS_PER_S // 4, 8
"""Period of the search for marks; number of searched frames that are averaged."""
NEWS_SHARE = 0.1
"""Fraction of the marks that has to differ before they are filled otherwise."""
Field = NDArray[np.float32]


class Verdict(NamedTuple):
    """The judgement of a frame.

    is_contact: whether it shows a contact. is_news: whether the marks have changed. was_mark: whether the
    contact that the frames before seemed to show was a mark, so that its angle is void.
    """

    is_contact: bool
    is_news: bool = False
    was_mark: bool = False


@dataclass(slots=True)
class _Suspicion:
    """A seeming contact of the first frames that its marks cover: a mark, or a contact that was there before.

    marked: (h, w) mask. area_px: of the region. since_ns: when it was seen first. still: number of further
    frames in which it has kept its area. grown: number of frames in a row in which the region was larger.
    """

    marked: Image
    area_px: int
    since_ns: int
    still: int = 0
    grown: int = 0

    @property
    def is_confirmed(self) -> bool:
        """Whether it is a mark, because a contact has come beside it."""
        return self.grown >= GROWN_FRAMES

    def is_refuted(self, region: Region | None, time_ns: int) -> bool:
        """Process the next frame; return whether it was a contact, which grows or ends, not a mark."""
        growth = 0.0 if region is None else region.area_px / self.area_px
        self.still += 1.0 / STILL <= growth <= STILL
        self.grown = self.grown + 1 if growth >= OUTGROWN else 0
        was_long = time_ns - self.since_ns >= to_ns(STILL_S) and self.still >= STILL_FRAMES
        return growth < 1.0 / STILL or (growth > STILL and not was_long)


class _QuietMean:
    """The mean of frames without contact. Those next to a contact are left out: it may be faintly visible."""

    def __init__(self) -> None:
        self._mean, self._count = np.zeros(0, np.float32), 0
        self._newest: Field | None = None
        self._is_after_contact = False

    def leave_out(self) -> None:
        """Leave out the frames before and after this one, which shows a contact."""
        self._newest, self._is_after_contact = None, True

    def add(self, difference: Field) -> Field | None:
        """Return the mean with the frame before this one; None if there is nothing new."""
        before, self._newest = self._newest, None if self._is_after_contact else difference
        self._is_after_contact = False
        if before is None:
            return None
        self._count = min(self._count + 1, AVERAGED)
        mean = self._mean if self._count > 1 else before
        self._mean = np.asarray(mean + (before - mean) / self._count, np.float32)
        return self._mean


class LaterMarks:
    """Decides for each frame of one sensor whether it shows a contact, and finds later marks in the others.

    marked: (h, w) mask of the marks, at first those of the background, see `found_marks`. Marks may look like
    a contact until they are filled. So the first frames are searched, and those of a contact that has become
    much weaker, because the object may have left something on the gel.
    """

    def __init__(self, marked: Image) -> None:
        self.marked = self._first = marked
        self._quiet = _QuietMean()
        self._suspicion: _Suspicion | None = None
        self._is_unclear, self._most = True, 0.0
        self._searched_ns: int | None = None

    @property
    def later(self) -> Image:
        """Mask of the marks that the background does not have, (h, w)."""
        return self.marked & ~self._first

    def judge(self, unfilled: Callable[[], Field], region: Region | None, time_ns: int) -> Verdict:
        """Judge the next frame. region: of the seeming contact, in the work copy, with the marks filled.

        unfilled: returns the relative difference (h, w, 3) of the frame, with its marks.
        """
        verdict = self._verdict(unfilled, region, time_ns)
        if verdict.is_contact:
            self._quiet.leave_out()
        return verdict

    def _verdict(self, unfilled: Callable[[], Field], region: Region | None, time_ns: int) -> Verdict:
        if self._suspicion is not None and self._suspicion.is_refuted(region, time_ns):
            self._suspicion = None
        if self._suspicion is not None and self._suspicion.is_confirmed:
            self.marked, self._suspicion = self._suspicion.marked, None
            return Verdict(False, is_news=True, was_mark=True)
        is_weak = self._is_weak(region)
        was_unclear = self._is_unclear = self._is_unclear and region is not None
        if not was_unclear and not (is_weak and self._is_due(time_ns)):
            return Verdict(region is not None)
        difference = unfilled()
        if region is not None:
            self._is_unclear = self._is_explained(difference, region, time_ns if was_unclear else None)
            if not self._is_unclear:
                return Verdict(True)
        return Verdict(False, is_news=self._is_news(difference))

    def _is_weak(self, region: Region | None) -> bool:
        """Whether there is no contact, or one that is much weaker than it was."""
        volume = 0.0 if region is None else region.area_px * region.strength
        self._most = 0.0 if region is None else max(self._most, volume)
        return region is None or volume < WEAK_SHARE * self._most

    def _is_due(self, time_ns: int) -> bool:
        """Whether a frame should be searched; the next one is due after `SEARCH_NS`."""
        is_due = self._searched_ns is None or time_ns - self._searched_ns >= SEARCH_NS
        self._searched_ns = time_ns if is_due else self._searched_ns
        return is_due

    def _is_explained(self, difference: Field, region: Region, first_ns: int | None) -> bool:
        """Whether a difference (h, w, 3) shows no contact if its marks are filled.

        The hull of marks is mostly empty. A region that is mostly covered counts as a contact; in the first
        frames it is observed. first_ns: time of a first frame, else None.
        """
        contact = region.mask
        size = contact.shape[1], contact.shape[0]
        marked = self._first | find_later_marks(difference)
        seeming = cv2.resize(contact, marked.shape[::-1], interpolation=cv2.INTER_NEAREST)
        covered = cv2.countNonZero(cv2.bitwise_and(marked, marked, mask=seeming))
        if covered > MOST_COVERED * cv2.countNonZero(seeming):
            if first_ns is not None:
                self._suspicion = _Suspicion(marked, region.area_px, first_ns)
            return False
        work = np.asarray(cv2.resize(difference, size, interpolation=cv2.INTER_AREA), np.float32)
        # The mean of the surroundings is enough here, and cheaper than a plane through them.
        clear = (cv2.resize(marked, size, interpolation=cv2.INTER_AREA) == 0).astype(np.float32)[..., None]
        sums = cv2.GaussianBlur(np.dstack([work * clear, clear]), (0, 0), FILL_PX)
        clean = np.where(clear > 0.0, work, sums[..., :3] / np.maximum(sums[..., 3:], 1e-3))
        return find_contact(smooth(clean)) is None

    def _is_news(self, difference: Field) -> bool:
        """Search a frame without contact; return whether the marks have changed."""
        mean = self._quiet.add(difference)
        if mean is None:
            return False
        marked = self._first | find_later_marks(mean)
        if cv2.countNonZero(marked ^ self.marked) <= NEWS_SHARE * cv2.countNonZero(marked | self.marked):
            return False
        self.marked = marked
        return True
