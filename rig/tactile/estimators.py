"""Estimators by their names."""

from dataclasses import dataclass

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.dot_free import DotFreeEstimator
from rig.tactile.contact.dots import is_dotted, without_dots
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator, PublishedEstimator
from rig.tactile.paper.published import ANGLES
from rig.tactile.paper.window import WindowMean
from rig.tactile.peers.ecc import EccMatcher, PolarMatcher, ReferenceEstimator
from rig.tactile.peers.kolamuri import KolamuriEstimator
from rig.tactile.peers.learned import AngleNetEstimator, ToskovEstimator
from rig.tactile.sample import TactileEstimator
from rig.tactile.slip.estimator import SlipEstimator

DEFAULT_ESTIMATOR = "slip"
PUBLISHED = "-published"
MATCHERS = {"ecc": EccMatcher, "polar": PolarMatcher}
KOLAMURI = "kolamuri"
"""Needs a gel with printed markers; without them it refuses every frame with contact."""
ANGLENET, TOSKOV = "anglenet", "toskov"
"""Networks trained on simulated lifts. `toskov` needs the arm's states beside the frames."""
PEERS = (KOLAMURI, ANGLENET, TOSKOV)
ESTIMATORS = (DEFAULT_ESTIMATOR, *METHODS, *(name + PUBLISHED for name in ANGLES), *MATCHERS, *PEERS)
WITH_RATE = (DEFAULT_ESTIMATOR,)
"""Those that tell how fast the object turns, so that a slip is known in time to react."""
PAPER_WINDOW, MAX_WINDOW = 2, 100


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """Which estimator, and how it runs.

    name: one of `ESTIMATORS`. window: mean over the last n angles, 1 to 100. skip: leave out what a
    frame does not need (`slip` only).
    """

    name: str
    window: int
    skip: bool = True

    def make(self, background: Image, aspect: float | None = None, sign: int = 1) -> TactileEstimator:
        """Build the estimator of one sensor.

        On a gel with printed dots it sees what lies between them; but for `kolamuri`, which follows them, and
        those of the published script.
        background: (H, W, 3) uint8 RGB, a frame without contact. aspect: width over height of a
        pixel on the gel where known (`slip` only; the paper's methods take pixels as square). sign: of
        the fingertip (`toskov` only, whose angle is the object's).
        """
        if self.name.endswith(PUBLISHED):
            method = ANGLES[self.name.removesuffix(PUBLISHED)]
            return PublishedEstimator(ContactFinder(background), method, self.window)
        if self._fills(background):
            estimator: TactileEstimator = DotFreeEstimator(self._of(without_dots(background), aspect, sign))
        else:
            estimator = self._of(background, aspect, sign)
        return WindowMean(estimator, self.window) if self.window > 1 else estimator

    def sees(self, background: Image) -> str:
        """Say what of the frames of this gel the angles come from."""
        if self.name == KOLAMURI:
            return "the printed dots"
        if self._fills(background):
            return "what lies between the printed dots"
        return "the whole frame"

    def _fills(self, background: Image) -> bool:
        return self.name != KOLAMURI and not self.name.endswith(PUBLISHED) and is_dotted(background)

    def _of(self, background: Image, aspect: float | None, sign: int) -> TactileEstimator:
        if self.name == DEFAULT_ESTIMATOR:
            return SlipEstimator(background, aspect, self.skip)
        if self.name in MATCHERS:
            return ReferenceEstimator(background, MATCHERS[self.name])
        if self.name == KOLAMURI:
            return KolamuriEstimator(background)
        if self.name == ANGLENET:
            return AngleNetEstimator(background)
        if self.name == TOSKOV:
            return ToskovEstimator(background, sign)
        return AxisEstimator(ContactFinder(background), METHODS[self.name])


def choose_estimator(
    name: str | None = None, window: int | None = None, skip: bool = True
) -> EstimatorChoice:
    """Check a choice; by default `slip`, and the window of 2 for the paper's methods, 1 for the others.

    Raises `InputError` for an unknown name or a window out of range.
    """
    name = name or DEFAULT_ESTIMATOR
    if name not in ESTIMATORS:
        raise InputError(f"unknown estimator '{name}': choose one of {', '.join(ESTIMATORS)}")
    usual = 1 if name in (DEFAULT_ESTIMATOR, *MATCHERS, *PEERS) else PAPER_WINDOW
    window = usual if window is None else window
    if not 1 <= window <= MAX_WINDOW:
        raise InputError(f"window {window} is out of range: choose 1 to {MAX_WINDOW}")
    return EstimatorChoice(name, window, skip)
