"""Make estimators by name, the rig's own and foreign ones."""

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

import numpy as np

from calibration.gel.look import GelLook, load_look
from drivers.errors import EstimatorError, InputError, unknown_name
from drivers.named_classes import file_hint, installed_classes, is_class_name
from drivers.types import Image
from rig.tactile.contact.dots import DotFreeEstimator, is_dotted, without_dots
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.foreign import GROUP, ForeignEstimator, require_estimator
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator, PublishedEstimator, WindowMean
from rig.tactile.paper.published import ANGLES
from rig.tactile.peers.ecc import EccEstimator
from rig.tactile.peers.kolamuri import KolamuriEstimator
from rig.tactile.peers.learned import AngleNetEstimator, ToskovEstimator
from rig.tactile.sample import TactileEstimator

DEFAULT_ESTIMATOR = "slip"
PUBLISHED = "-published"
ECC = "ecc"
KOLAMURI = "kolamuri"
"""Needs a gel with printed markers; without markers it refuses every frame with contact."""
ANGLENET, TOSKOV = "anglenet", "toskov"
"""Networks trained on simulated lifts. `toskov` also needs the states of the arm."""
PEERS = (KOLAMURI, ANGLENET, TOSKOV)
ESTIMATORS = (DEFAULT_ESTIMATOR, *METHODS, *(name + PUBLISHED for name in ANGLES), ECC, *PEERS)
WITH_RATE = (DEFAULT_ESTIMATOR,)
"""Estimators that report the rotation rate, which the reaction to slip needs."""
PAPER_WINDOW, MAX_WINDOW = 2, 100
ASPECTS = 0.5, 2.0
"""Smallest and largest pixel aspect, as in a bench file."""


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """An estimator and its settings.

    name: one of `ESTIMATORS`, an entry point of the group `slip_rig.estimators`, or
    `package.module:Class`. window: number of angles in the mean, 1 to 100. skip: skip stages that a
    frame does not need (`slip` only). named: whether the operator named it for this run. A foreign estimator
    that only a stored session names is not imported. gel: calibrated look of the sensor (`slip` only).
    """

    name: str
    window: int
    skip: bool = True
    named: bool = field(default=True, compare=False)
    gel: GelLook | None = field(default=None, compare=False)

    def make(self, background: Image, aspect: float | None = None, sign: int = 1) -> TactileEstimator:
        """Make the estimator for one sensor.

        background: (H, W, 3) uint8 RGB, a frame without contact. aspect: width of a pixel on the gel divided
        by its height, if known (`slip` only; the paper's methods assume square pixels). sign: of the
        fingertip (`toskov` only, whose network estimates the object's angle). Raises `EstimatorError` if it
        cannot be made.

        If the gel has printed dots, they are filled in each frame. Exceptions are `kolamuri`, which tracks
        the dots, the published scripts, and foreign estimators, which get the frames unchanged.
        """
        if self.name.endswith(PUBLISHED) and not self.foreign:
            method = ANGLES[self.name.removesuffix(PUBLISHED)]
            return PublishedEstimator(ContactFinder(background), method, self.window)
        if self._fills(background):
            estimator: TactileEstimator = DotFreeEstimator(self._of(without_dots(background), aspect, sign))
        else:
            estimator = self._of(background, aspect, sign)
        return WindowMean(estimator, self.window) if self.window > 1 else estimator

    def try_making(self) -> None:
        """Make the estimator once with a grey background before a lift, to detect errors and compile loops.

        Raises `EstimatorError`. An `InputError` is ignored, because the grey background may be its only
        cause.
        """
        try:
            self.make(np.full((320, 240, 3), 128, np.uint8))
        except EstimatorError:
            raise
        except InputError:
            return

    def begin_trying(self) -> Callable[[], bool]:
        """Do the same as `try_making`, but compile loops in a thread; return whether the thread has ended.

        The program ends only after the thread, because Python may crash at exit in the middle of it.
        """
        if self.name != DEFAULT_ESTIMATOR:
            self.try_making()
            return lambda: True
        thread = Thread(target=_compile_loops, name="compiling")
        thread.start()
        return lambda: not thread.is_alive()

    @property
    def foreign(self) -> bool:
        """Whether the estimator is not one of the rig's own."""
        return is_foreign(self.name)

    def require_named(self) -> None:
        """Raise `EstimatorError` for a foreign estimator that only a stored session names."""
        if self.foreign and not self.named:
            raise EstimatorError(
                f"the session names the estimator '{self.name}', which is not part of the rig and runs only "
                f"if you name it: add --estimator {shlex.quote(self.name)}, or another"
            )

    def sees(self, background: Image) -> str:
        """Return a text that names the part of the frames from which the angles are estimated."""
        if self.name == KOLAMURI:
            return "the printed dots"
        if self._fills(background):
            return "what lies between the printed dots"
        return "the whole frame"

    def _fills(self, background: Image) -> bool:
        whole = self.foreign or self.name == KOLAMURI or self.name.endswith(PUBLISHED)
        return not whole and is_dotted(background)

    def _of(self, background: Image, aspect: float | None, sign: int) -> TactileEstimator:
        if self.foreign:
            self.require_named()
            return ForeignEstimator(self.name, background, aspect, sign)
        if self.name == DEFAULT_ESTIMATOR:
            from rig.tactile.slip.estimator import SlipEstimator  # here, because importing numba is slow

            return SlipEstimator(background, aspect, self.skip, self.gel)
        if self.name == ECC:
            return EccEstimator(background)
        if self.name == KOLAMURI:
            return KolamuriEstimator(background)
        if self.name == ANGLENET:
            return AngleNetEstimator(background)
        if self.name == TOSKOV:
            return ToskovEstimator(background, sign)
        return AxisEstimator(ContactFinder(background), METHODS[self.name])


def _compile_loops() -> None:
    from rig.tactile.slip.all_loops import compile_all  # here, because importing numba is slow

    compile_all()


def choose_estimator(
    name: str | None = None, window: int | None = None, skip: bool = True, gel: Path | None = None
) -> EstimatorChoice:
    """Return the estimator that the user chose, after checks.

    name: `slip` by default. window: by default 2 for the paper's methods, else 1. skip: as in
    `EstimatorChoice`. gel: YAML file of `rig calibrate tactile` with the look of the sensor. A foreign class
    is imported here. Raises `InputError` for an unknown name, a class that cannot be imported or is not an
    estimator, or a window out of range, and `CalibrationError` for the file.
    """
    name = DEFAULT_ESTIMATOR if name is None else name
    if is_foreign(name):
        _require_known(name)
        require_estimator(name)
    return EstimatorChoice(name, _window(name, window), skip, gel=None if gel is None else load_look(gel))


def stored_choice(name: str, window: int | None, skip: bool = True) -> EstimatorChoice:
    """Return the estimator that a stored session names; nothing is imported. Raises `InputError`."""
    return EstimatorChoice(name, _window(name, window), skip, named=False)


def is_foreign(name: str) -> bool:
    """Whether a name is not one of the rig's own estimators."""
    return name not in ESTIMATORS


def _require_known(name: str) -> None:
    offered = [found.name for found in installed_classes(GROUP)]
    if name not in offered and not is_class_name(name):
        also = file_hint(name) or ", or give one of your own as package.module:Class"
        raise unknown_name("estimator", name, (*ESTIMATORS, *offered), also)


def _window(name: str, window: int | None) -> int:
    usual = PAPER_WINDOW if name in (*METHODS, *(method + PUBLISHED for method in ANGLES)) else 1
    window = usual if window is None else window
    if not 1 <= window <= MAX_WINDOW:
        raise InputError(f"window {window} is out of range: choose 1 to {MAX_WINDOW}")
    return window
