"""Check whether a background shows a contact, and by how much the gel has changed since it was taken.

A contact adds edges to the image of the gel. So a background shows a contact if it has clear edges by
itself, or if its edges are stronger than those of other frames in the region that differs. The second holds
for the frames after the object was lifted off. Both are computed for single frames, so the check is the same
for recorded and for live frames.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.misfit import Misfit, lines_of
from rig.tactile.contact.untouched import Comparison
from rig.tactile.sample import check_frame

TAKE_AGAIN = "lift the object, take another background"
"""Remedy for the doubts in a live stream."""
LESS_COMPRESSION = "store or send them with JPEG quality 80 or more"
"""Remedy for strong compression."""
LOOKS_LIKE_CONTACT = "this background looks like a contact"
"""Text of the doubt; the caller adds the remedy."""
FIRST_NS, SOON_NS, IDLE_NS, LATER_NS = NS_PER_S // 4, NS_PER_S // 10, NS_PER_S // 2, 4 * NS_PER_S
"""Intervals of the checked frames of a live sensor. Each frame doubles the interval, beginning with the
first: up to `IDLE_NS` if the frame does not differ from the background and so proves nothing, else up to
`LATER_NS`. After a suspicious frame it is `SOON_NS`."""
BORDER_PX = 5
"""Border of the reduced copy that is not checked for clear edges: the rim of the gel is dark."""
CLEAR_EDGES = 0.09
"""Gradient of the log image, per pixel of the reduced copy, that 1 % of a background with contact exceeds.
Without contact it is at most 0.065: 80 simulated units, rotation_clips, real_turns, both sets of balls."""
STRONGER = 0.06
"""Smallest log ratio of the edges of background and frame that is evidence of a contact in the background.
With their own background, frames of rotation_clips, real_turns, the balls and the fakes have at most 0.05."""
PER_NS, MOST_NS = NS_PER_S // 25, NS_PER_S // 4
"""The ratio of a frame counts once per `PER_NS` since the frame before, up to `MOST_NS`, so that the evidence
does not depend on the number of checked frames."""
MOST_PER_FRAME, ENOUGH = 0.2, 0.5
"""Largest evidence of one frame, and sum from which on the background is doubtful: at least three frames."""
CLEARLY_WEAKER = -0.3
"""Log ratio of a contact in a frame to a background without contact. It shows that the edges of a background
with `CLEAR_EDGES` are dirt or the rim of the gel."""


class BackgroundCheck:
    """Collects evidence from frames that a background shows a contact, or that they do not fit it.

    background: (H, W, 3) uint8 RGB.
    """

    def __init__(self, background: Image) -> None:
        check_frame(background)
        self._shape = background.shape
        self._comparison = Comparison(background)
        self._slopes = self._comparison.slopes(background)
        inner = self._slopes[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
        self._edged = bool(inner.size) and float(np.percentile(inner, 99.0)) > CLEAR_EDGES
        self._evidence = 0.0
        self._fit = Misfit(background, self._comparison)
        self._compared_ns: int | None = None
        self._steps: Iterator[None] | None = None
        self._newest_ns: int | None = None
        self._begun_ns, self._interval_ns = 0, FIRST_NS

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
        """Process the next frame of a live sensor: check it if a check is due.

        The check is divided into five steps of less than 1 ms, one in each call, or two if the frames are far
        apart. image: (H, W, 3) uint8 RGB; do not modify it later. Raises `InputError` for a frame of another
        shape or type.
        """
        check_frame(image, self._shape)
        last_ns, self._newest_ns = self._newest_ns, time_ns
        due = last_ns is None or not 0 <= time_ns - self._begun_ns < self._interval_ns
        if self._steps is None and due:
            self._steps, self._begun_ns = self._check(image, time_ns), time_ns
        for _ in range(1 if last_ns is None or time_ns - last_ns < SOON_NS else 2):
            if self._steps is not None and next(self._steps, self) is self:
                self._steps = None

    def check(self, image: Image, time_ns: int) -> None:
        """Check a frame of a recording completely. Raises `InputError` as `add` does."""
        check_frame(image, self._shape)
        for _ in self._check(image, time_ns):
            pass

    def _check(self, image: Image, time_ns: int) -> Iterator[None]:
        """Check a frame, step by step, and set the time to the next one."""
        work = self._comparison.reduce(image)
        yield
        light = self._comparison.light(work)
        region = self._comparison.region(work, light)
        yield
        lines = lines_of(image)
        unfit, edged = self._fit.add_blocks(lines), False
        if region is not None:
            edged = self._weigh(self._comparison.edge_ratio_in(region, work, self._slopes), time_ns)
            yield
            unfit |= yield from self._fit.add(lines, work, light)
        suspicious = edged or (unfit and not self.misfit)
        longest_ns = IDLE_NS if region is None else LATER_NS
        self._interval_ns = SOON_NS if suspicious else min(2 * self._interval_ns, longest_ns)

    def _weigh(self, ratio: float, time_ns: int) -> bool:
        """Add the evidence of a frame's edges; return whether more frames are needed."""
        last_ns, self._compared_ns = self._compared_ns, time_ns
        times = 1.0 if last_ns is None else min(max(time_ns - last_ns, 0), MOST_NS) / PER_NS
        self._edged = self._edged and ratio > CLEARLY_WEAKER
        if self._evidence < ENOUGH:
            more = min(times * (ratio - STRONGER), MOST_PER_FRAME)
            self._evidence = max(0.0, self._evidence + more)
        return ratio > STRONGER and self._evidence < ENOUGH


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
