"""What came of a frame source: how many frames, how many did not come, whether it froze, its times jumped."""

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Frame

LONGEST_STEP_NS, MOST_STEPS = NS_PER_S // 2, 20
"""A frame is at most this much, or this many steps, later or earlier than the frame before it."""
AGREEING_NS = 2 * NS_PER_S
"""Two frames in a row that jumped agree if they are at most this much, or MOST_STEPS steps, apart."""

FROZEN_FRAMES = 20
"""A live sensor has noise: this many identical frames in a row mean that it froze."""


class StreamTimes:
    """Tells a frame's time that can be from one that jumped.

    A frame whose time is far from that of the one before is set aside; where the next one agrees with it, the
    stream has paused, or begun anew, and goes on from there. So a wrong time costs its own frame, and a
    pause the frame after it.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._aside_ns: int | None = None
        self._step_ns: int | None = None

    def follows(self, time_ns: int) -> bool:
        """Take the next frame's time; return whether it can be. A little late or repeated, it can."""
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
        if before is None or time_ns > before:
            self._step_ns = None if before is None else time_ns - before
        self._last_ns, self._aside_ns = time_ns, None
        return True

    def _is_far(self, time_ns: int, from_ns: int, at_least_ns: int) -> bool:
        furthest = max(at_least_ns, MOST_STEPS * (self._step_ns or 0))
        return abs(time_ns - from_ns) > furthest


class FrameTally:
    """Takes one source's frames in order; the one place that says what is dropped, repeated, frozen, jumped.

    frames: that came. dropped: between the first and the newest, that never came: gaps in `Frame.sequence`.
    jumped: whose times cannot be, see `StreamTimes`.
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
        """Whether the newest frame's time jumped: what it shows is of another time than it says."""
        return self._out_of_time

    @property
    def repeated(self) -> bool:
        """Whether the newest frame shows the same image as the one before."""
        return self._repeats > 0

    @property
    def frozen(self) -> bool:
        """Whether the source has repeated its image so often that it must have frozen."""
        return self._repeats >= FROZEN_FRAMES


def _same_image(one: Frame, other: Frame) -> bool:
    """Whether two images are equal to the last bit; their encoded bytes tell at once."""
    if one.jpeg is not None and other.jpeg is not None:
        return one.jpeg == other.jpeg
    return np.array_equal(one.image, other.image)
