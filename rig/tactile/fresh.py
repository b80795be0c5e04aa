"""The rule for frames that bring nothing new."""

from dataclasses import replace
from typing import ClassVar

from drivers.types import Image
from rig.tactile.relative import check_frame
from rig.tactile.sample import SlipEstimator, SlipSample


class FreshFrameEstimator(SlipEstimator):
    """An estimator that looks at each frame once.

    A frame that is not newer than the one before (repeated, or delivered late) gets the last answer
    again and counts for nothing. shape: of the frames, (H, W, 3); any where None.
    """

    stages: ClassVar[tuple[str, ...]]
    """What a frame goes through, in order."""

    def __init__(self, shape: tuple[int, ...] | None = None) -> None:
        self._shape = shape
        self._last: SlipSample | None = None

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        check_frame(image, self._shape)
        if self._last is not None and time_ns <= self._last.time_ns:
            return replace(self._last, stage_s={}, skipped=self.stages)
        self._last = self._estimate(image, time_ns)
        return self._last

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from a frame that is newer than any before."""
        raise TypeError(f"{type(self).__name__} does not say how it estimates")
