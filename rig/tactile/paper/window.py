"""The paper's filter: the mean of the last n angles (section III-B)."""

from collections import deque
from dataclasses import replace

from drivers.types import ArmState, Image
from rig.tactile.sample import SlipSample, TactileEstimator


class WindowMean(TactileEstimator):
    """Another estimator's angles, averaged over the last n of them; after a refusal it starts empty.

    A frame that is not newer than the one before, or whose time jumped, counts for nothing.
    """

    def __init__(self, estimator: TactileEstimator, window: int) -> None:
        self._estimator = estimator
        self._angles: deque[float] = deque(maxlen=window)
        self._last: SlipSample | None = None

    def arm(self, state: ArmState) -> None:
        """Pass the arm's state on."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Pass it on."""
        self._estimator.gripped_further()

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        sample = self._estimator.update(image, time_ns)
        if sample.jumped:
            return sample
        if self._last is not None and sample.time_ns == self._last.time_ns:
            return replace(sample, angle_deg=self._last.angle_deg)
        if sample.angle_deg is None:
            self._angles.clear()
        else:
            self._angles.append(sample.angle_deg)
            sample = replace(sample, angle_deg=sum(self._angles) / len(self._angles))
        self._last = sample
        return sample
