"""The paper's method as an estimator: frame -> contact -> axis -> filter -> slip sample.

`skeleton`, `ellipse` and `pca` are the paper's three ways to an angle with the published script's
faults mended: true pixels instead of stretched ones, the sign kept, angles unwrapped over time,
frames counted instead of loop passes, and a refusal where the contact has no long axis. The same
names with `-published` answer as that script does (`rig.tactile.published`).
"""

import time
from collections import deque
from dataclasses import replace

import cv2

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.axis import METHODS, Axis, AxisMethod
from rig.tactile.contact import ContactFinder
from rig.tactile.published import ANGLES, ScriptAngle, ScriptError, ScriptFilter, stretched
from rig.tactile.relative import check_frame
from rig.tactile.sample import SlipEstimator, SlipSample, State

DEFAULT_ESTIMATOR = "skeleton"
DEFAULT_WINDOW, MAX_WINDOW = 2, 100
PUBLISHED = "-published"
ESTIMATORS = (*METHODS, *(name + PUBLISHED for name in ANGLES))

# Ratio of long to short axis at which a contact's angle is believed first, and down to which it is
# followed. On the nine real frames our masks of nearly round contacts differ from the human labels
# by up to 0.3 in it: below that, the light may have drawn the axis.
ELONGATION_ENTER, ELONGATION_LEAVE = 1.3, 1.15


def make_estimator(name: str, background: Image, window: int = DEFAULT_WINDOW) -> SlipEstimator:
    """Build the estimator of one sensor by its name, one of `ESTIMATORS`.

    background: (H, W, 3) uint8 RGB without contact. window: mean over the last n angles, 1 to 100.
    Raises `InputError` for an unknown name, a window out of range, an unusable background.
    """
    if name not in ESTIMATORS:
        raise InputError(f"unknown estimator '{name}': choose one of {', '.join(ESTIMATORS)}")
    if not 1 <= window <= MAX_WINDOW:
        raise InputError(f"window {window} is out of range: choose 1 to {MAX_WINDOW}")
    finder = ContactFinder(background)
    if name.endswith(PUBLISHED):
        return PublishedEstimator(finder, ANGLES[name.removesuffix(PUBLISHED)], window)
    return AxisEstimator(finder, METHODS[name], window)


class Stopwatch:
    """Wall time of the stages of one frame, s; for reports of cost only, never for results."""

    def __init__(self) -> None:
        self.stage_s: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under a stage."""
        now = time.perf_counter()
        self.stage_s[stage] = now - self._since
        self._since = now


class AxisEstimator(SlipEstimator):
    """One of the paper's methods, mended.

    States: `no_contact`; `unobservable` where the contact is too round for an axis (its axis ratio
    has not reached 1.3, or fell below 1.15) or encloses nothing; else `tracking`. After a refusal
    the window starts empty. When contact returns after it was lost, the first answer is `rekeyed`:
    the measured axis in the branch nearest to the last answer, as a turn in between is known
    modulo 180 only. A frame that is not newer than the one before gets the last answer again and
    counts for nothing.
    """

    def __init__(self, finder: ContactFinder, method: AxisMethod, window: int) -> None:
        self._finder = finder
        self._method = method
        self._angles: deque[float] = deque(maxlen=window)
        self._unwrapped_deg: float | None = None
        self._contact_lost = False
        self._observable = False
        self._last: SlipSample | None = None

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        if self._last is not None and time_ns <= self._last.time_ns:
            check_frame(image)
            return replace(self._last, stage_s={}, skipped=("contact", "axis", "filter"))
        self._last = self._estimate(image, time_ns)
        return self._last

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        contact = self._finder.find(image)
        watch.lap("contact")
        if contact.mask is None:
            self._lose_contact()
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=("axis", "filter"))
        axis = self._method(contact.contour)
        watch.lap("axis")
        blind = SlipSample(
            time_ns, State.UNOBSERVABLE, contact_area_px=contact.area_px, stage_s=watch.stage_s
        )
        least = ELONGATION_LEAVE if self._observable else ELONGATION_ENTER
        self._observable = axis is not None and axis.elongation >= least
        if axis is None or not self._observable:
            self._angles.clear()
            return replace(blind, skipped=("filter",))
        state = State.REKEYED if self._contact_lost else State.TRACKING
        angle_deg = self._filtered(axis)
        watch.lap("filter")
        return replace(blind, state=state, angle_deg=angle_deg)

    def _lose_contact(self) -> None:
        self._angles.clear()
        self._observable = False
        self._contact_lost = self._unwrapped_deg is not None

    def _filtered(self, axis: Axis) -> float:
        """Unwrap modulo 180 against the last measured angle and average over the window."""
        self._contact_lost = False
        if self._unwrapped_deg is None:
            self._unwrapped_deg = axis.angle_deg
        else:
            turns = round((self._unwrapped_deg - axis.angle_deg) / 180.0)
            self._unwrapped_deg = axis.angle_deg + 180.0 * turns
        self._angles.append(self._unwrapped_deg)
        return sum(self._angles) / len(self._angles)


class PublishedEstimator(SlipEstimator):
    """One of the paper's methods as published, fed with our contact mask.

    It answers every frame, as the script does: 0 without contact (state `no_contact`) and until
    the window is full. Where the script would end with an exception the state is `lost` and there
    is no angle. Repeated frames count again. Nothing but the mask's origin differs from the script.
    """

    def __init__(self, finder: ContactFinder, method: ScriptAngle, window: int) -> None:
        self._finder = finder
        self._method = method
        self._filter = ScriptFilter(window)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        watch = Stopwatch()
        contact = self._finder.find(image)
        watch.lap("contact")
        area = contact.area_px
        try:
            angle_deg = None if contact.mask is None else self._method(stretched(contact.mask))
        except (ScriptError, cv2.error):
            return SlipSample(
                time_ns, State.LOST, contact_area_px=area, stage_s=watch.stage_s, skipped=("filter",)
            )
        watch.lap("axis")
        published_deg = self._filter.update(angle_deg)
        watch.lap("filter")
        state = State.NO_CONTACT if angle_deg is None else State.TRACKING
        return SlipSample(time_ns, state, published_deg, contact_area_px=area, stage_s=watch.stage_s)
