"""Run an estimator on a gel with printed dots, on frames whose dots are filled."""

from dataclasses import replace

from drivers.types import ArmState, Image
from rig.tactile.contact.dots import without_dots
from rig.tactile.sample import SlipSample, TactileEstimator
from rig.tactile.stopwatch import Stopwatch

DOTS = "dots"
"""Name of the stage that fills the dots."""


class DotFreeEstimator(TactileEstimator):
    """Fills the dots of each frame, then passes the frame to another estimator.

    estimator: an estimator that was made with a background whose dots are filled.
    """

    def __init__(self, estimator: TactileEstimator) -> None:
        self._estimator = estimator

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises only `InputError`, for another shape or type."""
        watch = Stopwatch()
        plain = without_dots(image)
        watch.lap(DOTS)
        sample = self._estimator.update(plain, time_ns)
        return replace(sample, stage_s={**watch.stage_s, **sample.stage_s})

    def arm(self, state: ArmState) -> None:
        """Pass the state of the arm on."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Notify the estimator that the fingers have closed further."""
        self._estimator.gripped_further()
