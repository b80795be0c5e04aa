"""Make the estimators to compare; they run once without window, and every window is applied afterwards."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.estimators import DEFAULT_ESTIMATOR, ECC, PUBLISHED, choose_estimator
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator, FindsContact, WindowMean
from rig.tactile.paper.published import ANGLES, ScriptAngle, ScriptError, ScriptFilter, stretched
from rig.tactile.sample import SlipSample, State, TactileEstimator

PAPER = (*METHODS, *(name + PUBLISHED for name in ANGLES))
CONTENDERS = (DEFAULT_ESTIMATOR, ECC, *PAPER)
WINDOWS = tuple(range(1, 11))
"""Windows to compare; 1 is no filter. The paper compares 2 to 10."""


def complete(name: str, background: Image, aspect: float | None = None, sign: int = 1) -> TactileEstimator:
    """Make an estimator with its default window, as users run it, for the measurement of run time.

    aspect, sign: as for `EstimatorChoice.make`.
    """
    return choose_estimator(name).make(background, aspect, sign)


def unfiltered(
    background: Image, aspect: float | None = None, names: Sequence[str] = CONTENDERS, sign: int = 1
) -> dict[str, TactileEstimator]:
    """Make estimators without a window, by name; those of the paper share one contact mask.

    A published estimator reports the script's angle of the frame (clockwise, signed), None without contact.
    """
    finder = SharedContact(ContactFinder(background))
    return {name: _unfiltered(name, background, aspect, finder, sign) for name in names}


def filtered(name: str, samples: Sequence[SlipSample], window: int) -> list[SlipSample]:
    """Apply a window of n angles to the samples of an unfiltered run."""
    if name in PAPER and name.endswith(PUBLISHED):
        script = ScriptFilter(window)
        return [_published(sample, script) for sample in samples]
    if window == 1:
        return list(samples)
    mean = WindowMean(_Replayed(samples), window)
    unseen = np.empty((0, 0, 3), np.uint8)
    return [mean.update(unseen, sample.time_ns) for sample in samples]


def _published(sample: SlipSample, script: ScriptFilter) -> SlipSample:
    """Return a sample after the script's filter; a sample without contact is unchanged."""
    if sample.state is State.LOST:
        return sample
    angle_deg = script.update(sample.angle_deg)
    return sample if sample.state is State.NO_CONTACT else replace(sample, angle_deg=angle_deg)


class SharedContact:
    """Finds the contact once per frame for several estimators. cost_s: run time of each search."""

    def __init__(self, finder: FindsContact) -> None:
        self._finder = finder
        self._of: Image | None = None
        self._found: Contact | None = None
        self.cost_s: list[float] = []

    def find(self, image: Image) -> Contact:
        """Return the contact in a frame; repeated calls with the same array do not search again."""
        if self._found is None or image is not self._of:
            began = perf_counter()
            self._of, self._found = image, self._finder.find(image)
            self.cost_s.append(perf_counter() - began)
        return self._found


@dataclass(slots=True)
class ScriptPass(TactileEstimator):
    """Reports the published script's angle of each frame before its filter, with the rig's contact mask."""

    finder: FindsContact
    angle: ScriptAngle

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Return the script's angle; None without contact, and state `lost` if the script raises."""
        contact = self.finder.find(image)
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT)
        try:
            angle_deg = self.angle(stretched(contact.mask))
        except (ScriptError, cv2.error):
            return SlipSample(time_ns, State.LOST)
        return SlipSample(time_ns, State.TRACKING, angle_deg)


class _Replayed(TactileEstimator):
    """Returns stored samples in order."""

    def __init__(self, samples: Sequence[SlipSample]) -> None:
        self._samples = iter(samples)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Return the next sample."""
        return next(self._samples)


def _unfiltered(
    name: str, background: Image, aspect: float | None, finder: FindsContact, sign: int
) -> TactileEstimator:
    if name in PAPER and name.endswith(PUBLISHED):
        return ScriptPass(finder, ANGLES[name.removesuffix(PUBLISHED)])
    if name in METHODS:
        return AxisEstimator(finder, METHODS[name])
    return choose_estimator(name, 1).make(background, aspect, sign)
