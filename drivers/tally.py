"""Frame statistics of a source: received, dropped, repeated, frozen, and frames with an invalid time."""

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Frame

LONGEST_STEP_NS, MOST_STEPS = NS_PER_S // 2, 20
"""A frame time is valid if it is at most this far, or MOST_STEPS frame intervals, from the previous one."""
AGREEING_NS = 2 * NS_PER_S
"""Two successive outliers agree if they are at most this far, or MOST_STEPS frame intervals, apart."""

FROZEN_FRAMES = 20
"""A live sensor has noise: this many identical frames in a row mean that it has frozen."""


class StreamTimes:
    """Detects frames whose capture time has jumped.

    The first frame whose time is far from that of the previous frame is an outlier. If the next frame agrees
    with the outlier, the stream has paused or restarted, and is followed from there. So a single wrong time
    costs one frame, and a pause costs the first frame after it.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._aside_ns: int | None = None
        self._step_ns: int | None = None
        self.sparse = False
        """Whether the newest two frames are too far apart for a motion between them to be followed."""

    def follows(self, time_ns: int) -> bool:
        """Add the time of the next frame; return whether it is valid. Small delays and repeats are valid."""
        last = self._last_ns
        if last is None or self._step_ns is None:
            jumped = last is not None and time_ns < last - LONGEST_STEP_NS and self._aside_ns is None
        else:
            jumped = self._is_far(time_ns, last, LONGEST_STEP_NS) and (
                self._aside_ns is None or self._is_far(time_ns, self._aside_ns, AGREEING_NS)
            )
        if jumped:
            self._aside_ns = time_ns
            return False
        before = last if self._aside_ns is None else self._aside_ns
        # after a pause, or a single wrong time, one of the two is near
        self.sparse = all(near is not None and time_ns - near > LONGEST_STEP_NS for near in (last, before))
        if before is None or time_ns > before:
            self._step_ns = None if before is None else time_ns - before
        self._last_ns, self._aside_ns = time_ns, None
        return True

    def _is_far(self, time_ns: int, from_ns: int, at_least_ns: int) -> bool:
        furthest = max(at_least_ns, MOST_STEPS * (self._step_ns or 0))
        return abs(time_ns - from_ns) > furthest


class FrameTally:
    """Counts the frames of one source, in order; the only definition of dropped, repeated, frozen, jumped.

    frames: number received. dropped: number missing between the first and the newest frame, from gaps in
    `Frame.sequence`. jumped: number with an invalid time, see `StreamTimes`.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.dropped = 0
        self.jumped = 0
        self._times = StreamTimes()
        self._out_of_time = False
        self._repeats = 0
        self._last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Count a frame."""
        last, self._last = self._last, frame
        self.frames += 1
        self._out_of_time = not self._times.follows(frame.time_ns)
        self.jumped += self._out_of_time
        if last is not None:
            self.dropped += frame.sequence - last.sequence - 1
            self._repeats = self._repeats + 1 if _same_image(frame, last) else 0

    @property
    def out_of_time(self) -> bool:
        """Whether the newest frame's time jumped, so that it is not the time at which the image was taken."""
        return self._out_of_time

    @property
    def repeated(self) -> bool:
        """Whether the newest frame shows the same image as the frame before."""
        return self._repeats > 0

    @property
    def frozen(self) -> bool:
        """Whether the source has repeated its image `FROZEN_FRAMES` times, so that it must have frozen."""
        return self._repeats >= FROZEN_FRAMES


def _same_image(one: Frame, other: Frame) -> bool:
    """Whether two images are bitwise equal; encoded bytes, if both have them, are faster to compare."""
    if one.jpeg is not None and other.jpeg is not None:
        return one.jpeg == other.jpeg
    return np.array_equal(one.image, other.image)
