"""Check whether a background shows a contact, and by how much the gel has changed since it was taken.

A contact adds edges to the image of the gel. So a background shows a contact if it has clear edges by
itself, or if its edges are stronger than those of other frames in the region that differs. The second holds
for the frames after the object was lifted off. Both are computed for single frames, so the check is the same
for recorded and for live frames.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.misfit import Misfit
from rig.tactile.contact.untouched import Comparison
from rig.tactile.sample import check_frame

TAKE_AGAIN = "lift the object, take another background"
"""Remedy for the doubts in a live stream."""
LESS_COMPRESSION = "store or send them with JPEG quality 80 or more"
"""Remedy for strong compression."""
LOOKS_LIKE_CONTACT = "this background looks like a contact"
"""Text of the doubt; the caller adds the remedy."""
CHECK_EVERY_NS = NS_PER_S // 10
"""Interval of the checked frames of a live sensor."""
FIT_EVERY_NS = NS_PER_S // 100
"""Interval of the frames searched for a shift, times the number of those before: a search takes 1.6 ms."""
BORDER_PX = 5
"""Border of the reduced copy that is not checked for clear edges: the rim of the gel is dark."""
CLEAR_EDGES = 0.09
"""Gradient of the log image, per pixel of the reduced copy, that 1 % of a background with contact exceeds.
Without contact it is at most 0.065: 80 simulated units, rotation_clips, real_turns, both sets of balls."""
STRONGER = 0.06
"""Smallest log ratio of the edges of background and frame that is evidence of a contact in the background.
With their own background, frames of rotation_clips, real_turns, the balls and the fakes have at most 0.05."""
MOST_PER_FRAME, ENOUGH = 0.2, 0.5
"""Largest evidence of one frame, and sum from which on the background is doubtful: at least three frames."""
CLEARLY_WEAKER = -0.3
"""Log ratio of a contact in a frame to a background without contact. It shows that the edges of a background
with `CLEAR_EDGES` are dirt or the rim of the gel."""


class BackgroundCheck:
    """Collects evidence from frames that a background shows a contact.

    background: (H, W, 3) uint8 RGB. every_ns: interval of the checked frames; 0 for all.
    """

    def __init__(self, background: Image, every_ns: int = 0) -> None:
        check_frame(background)
        self._every_ns, self._shape = every_ns, background.shape
        self._comparison = Comparison(background)
        self._slopes = self._comparison.slopes(background)
        inner = self._slopes[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
        self._edged = bool(inner.size) and float(np.percentile(inner, 99.0)) > CLEAR_EDGES
        self._evidence = 0.0
        self._checked_ns: int | None = None
        self._fit, self._compared, self._fit_ns = Misfit(background, self._comparison), 0, 0
        self._fit_due = False

    @property
    def doubt(self) -> str:
        """Why the background is doubtful: it does not fit the frames, or looks like a contact; else ""."""
        return self.misfit or (LOOKS_LIKE_CONTACT if self._edged or self._evidence >= ENOUGH else "")

    @property
    def misfit(self) -> str:
        """Why the frames have no angle: they do not fit the background, or are compressed; else ""."""
        return self._fit.text

    def doubt_with(self, remedy: str) -> str:
        """Return the doubt and what to do, "" without a doubt. remedy: for a background to take again."""
        return f"{self.doubt}: {LESS_COMPRESSION if self._fit.compressed else remedy}" if self.doubt else ""

    def add(self, image: Image, time_ns: int) -> None:
        """Compare a frame with the background, unless the last checked frame is too close in time.

        Raises `InputError` for a frame of another shape or type.
        """
        check_frame(image, self._shape)
        if self._fit_due:  # in the frame after the edges, so that a live stream waits for one of both
            self._fit_due = False
            self._fit.add(image)
        if self._checked_ns is not None and 0 <= time_ns - self._checked_ns < self._every_ns:
            return
        self._checked_ns = time_ns
        self._fit.add_blocks(image)
        ratio = self._comparison.edge_ratio(image, self._slopes)
        if ratio is None:
            return
        if self._compared == 0 or time_ns - self._fit_ns >= FIT_EVERY_NS * self._compared:
            self._compared, self._fit_ns, self._fit_due = self._compared + 1, time_ns, True
        self._edged = self._edged and ratio > CLEARLY_WEAKER
        if self._evidence < ENOUGH:
            self._evidence = max(0.0, self._evidence + min(ratio - STRONGER, MOST_PER_FRAME))


@dataclass(frozen=True, slots=True)
class GelChange:
    """Change of the gel between two backgrounds.

    light: relative change of the mean brightness. gel: relative difference that 1 % of the pixels exceed,
    after correction for the light. contact: which of both shows a contact, "before" or "now"; None if both
    agree; "" if they differ without clear edges.
    """

    light: float
    gel: float
    contact: str | None

    @property
    def text(self) -> str:
        """The change in numbers."""
        return f"light {100 * self.light:+.0f} %, gel {100 * self.gel:.0f} %"


def gel_change(before: Image, now: Image) -> GelChange:
    """Return the change between two backgrounds of one sensor, both (H, W, 3) uint8 RGB."""
    comparison = Comparison(before)
    ratio = comparison.edge_ratio(now, comparison.slopes(before))
    contact = None if ratio is None else "before" if ratio > STRONGER else "now" if ratio < -STRONGER else ""
    size = np.linalg.norm(comparison.difference(now), axis=2)
    gel = float(np.percentile(cv2.GaussianBlur(size, (0, 0), 1.5), 99.0))
    return GelChange(float(now.mean() / max(before.mean(), 1.0)) - 1.0, gel, contact)
