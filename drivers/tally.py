"""What came of a frame source: how many frames, how many did not come, and whether the source froze."""

import numpy as np

from drivers.types import Frame

FROZEN_FRAMES = 20
"""A live sensor has noise: this many identical frames in a row mean that it froze."""


class FrameTally:
    """Takes one source's frames in order; the one place that says what is dropped, repeated, frozen.

    frames: that came. dropped: between the first and the newest, that never came: gaps in `Frame.sequence`.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.dropped = 0
        self._repeats = 0
        self._last: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Count a frame."""
        last, self._last = self._last, frame
        self.frames += 1
        if last is not None:
            self.dropped += frame.sequence - last.sequence - 1
            self._repeats = self._repeats + 1 if _same_image(frame, last) else 0

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
