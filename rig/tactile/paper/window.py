"""The paper's filter: the mean of the last n angles (section III-B)."""

from collections import deque
from dataclasses import replace

from drivers.types import ArmState, Image
from rig.tactile.sample import SlipSample, TactileEstimator


class WindowMean(TactileEstimator):
    """Wraps an estimator and reports the mean of its last n angles; a refused frame empties the window.

    A frame that is not newer than the previous one, or whose time jumped, is not counted.
    """

    def __init__(self, estimator: TactileEstimator, window: int) -> None:
        self._estimator = estimator
        self._angles: deque[float] = deque(maxlen=window)
        self._last: SlipSample | None = None

    def arm(self, state: ArmState) -> None:
        """Pass the state of the arm on."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Notify the estimator that the fingers have closed further."""
        self._estimator.gripped_further()

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises only `InputError`, for another shape or type."""
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
