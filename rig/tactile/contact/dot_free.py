"""An estimator of a dotted gel that sees what lies between the dots."""

from dataclasses import replace

from drivers.types import ArmState, Image
from rig.tactile.contact.dots import without_dots
from rig.tactile.sample import SlipSample, TactileEstimator
from rig.tactile.stopwatch import Stopwatch

DOTS = "dots"
"""The stage in which they are filled."""


class DotFreeEstimator(TactileEstimator):
    """Fills the dots of each frame before another estimator sees it.

    estimator: made with a background whose dots are filled.
    """

    def __init__(self, estimator: TactileEstimator) -> None:
        self._estimator = estimator

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        watch = Stopwatch()
        plain = without_dots(image)
        watch.lap(DOTS)
        sample = self._estimator.update(plain, time_ns)
        return replace(sample, stage_s={**watch.stage_s, **sample.stage_s})

    def arm(self, state: ArmState) -> None:
        """Take the arm's state."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Take note that the fingers have closed further."""
        self._estimator.gripped_further()
