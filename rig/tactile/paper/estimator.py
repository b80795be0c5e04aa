"""The paper's methods as estimators: frame -> contact -> axis -> filter -> slip sample.

`skeleton`, `ellipse` and `pca` are the paper's three methods, with the faults of the published script
corrected: the image is not stretched, the sign is kept, angles are unwrapped over time, the window is a
number of new frames (the script also counts repeated ones), and a contact without a long axis is refused.
The same names with `-published` reproduce the script (`rig.tactile.paper.published`).
"""

from collections import deque
from dataclasses import replace
from typing import Protocol

import cv2

from drivers.tally import SELDOM_NS, PictureNews, StreamTimes
from drivers.types import ArmState, Image
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.paper.axis import Axis, AxisMethod
from rig.tactile.paper.published import ScriptAngle, ScriptError, ScriptFilter, stretch
from rig.tactile.sample import (
    FreshFrameEstimator,
    SlipSample,
    State,
    Stopwatch,
    TactileEstimator,
    check_frame,
)
from rig.tactile.settling import SettlingByArea


class WindowMean(TactileEstimator):
    """Wraps an estimator and reports the mean of its last n angles; a refused frame empties the window.

    A frame that is not newer than the previous one, or whose time jumped, is not counted.
    """

    def __init__(self, estimator: TactileEstimator, window: int) -> None:
        self._estimator = estimator
        self._angles: deque[float] = deque(maxlen=window)

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
        if sample.angle_deg is None:
            self._angles.clear()
        else:
            self._angles.append(sample.angle_deg)
            sample = replace(sample, angle_deg=sum(self._angles) / len(self._angles))
        return sample


# Ratio of long to short axis from which on the angle is reported, and below which it is refused again. On the
# nine real frames this ratio differs by up to 0.3 between our masks of nearly round contacts and the human
# labels, so a smaller ratio could be an effect of the light.
ELONGATION_ENTER, ELONGATION_LEAVE = 1.3, 1.15


class FindsContact(Protocol):
    """Interface that detects the contact for the axis methods, by image processing or a network."""

    def find(self, image: Image) -> Contact:
        """Return the contact in an (H, W, 3) uint8 RGB frame."""
        ...


class AxisEstimator(FreshFrameEstimator):
    """One of the paper's methods, corrected.

    States: `no_contact`; `unobservable` if the contact has no area or is too round for an axis (its axis
    ratio has not reached 1.3, or fell below 1.15); else `tracking`. If contact returns after it was lost, the
    first angle is `rekeyed`. It is the branch of the measured axis nearest to the last angle, because a
    rotation in between is known only modulo 180 degrees.
    """

    stages = ("contact", "axis", "filter")

    def __init__(self, finder: FindsContact, method: AxisMethod) -> None:
        super().__init__()
        self._finder = finder
        self._method = method
        self._unwrapped_deg: float | None = None
        self._contact_lost = False
        self._observable = False

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
            return replace(blind, skipped=("filter",))
        state = State.REKEYED if self._contact_lost else State.TRACKING
        angle_deg = self._unwrap(axis)
        watch.lap("filter")
        return replace(blind, state=state, angle_deg=angle_deg)

    def _lose_contact(self) -> None:
        self._observable = False
        self._contact_lost = self._unwrapped_deg is not None

    def _unwrap(self, axis: Axis) -> float:
        """Return the axis angle, unwrapped modulo 180 degrees against the last angle."""
        self._contact_lost = False
        if self._unwrapped_deg is None:
            self._unwrapped_deg = axis.angle_deg
        else:
            turns = round((self._unwrapped_deg - axis.angle_deg) / 180.0)
            self._unwrapped_deg = axis.angle_deg + 180.0 * turns
        return self._unwrapped_deg


class PublishedEstimator(TactileEstimator):
    """One of the paper's methods as published, with the contact mask of the rig.

    As in the script, every frame with contact has an angle, which is 0 until the window is full, and repeated
    frames are counted again. There are four differences: the origin of the mask; without contact there is no
    angle and the state is `no_contact`, whereas the script repeats its last angle; if the script would end
    with an exception, there is no angle and the state is `lost`; and the frames of a frozen source have no
    angle and the state `frozen`.
    """

    def __init__(self, finder: ContactFinder, method: ScriptAngle, window: int) -> None:
        self._finder = finder
        self._method = method
        self._filter = ScriptFilter(window)
        self._times, self._settling, self._news = StreamTimes(), SettlingByArea(), PictureNews(SELDOM_NS)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises only `InputError`, for another shape or type."""
        if not self._times.follows(time_ns):
            return SlipSample(time_ns, State.LOST, jumped=True)
        check_frame(image)
        self._news.add(image, time_ns)
        if self._news.frozen:
            return SlipSample(time_ns, State.FROZEN, settled=self._settling.update(0.0, time_ns))
        sample = self._estimate(image, time_ns)
        return replace(sample, settled=self._settling.update(sample.contact_area_px, time_ns))

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        contact = self._finder.find(image)
        watch.lap("contact")
        area = contact.area_px
        try:
            angle_deg = None if contact.mask is None else self._method(stretch(contact.mask))
        except (ScriptError, cv2.error):
            return SlipSample(
                time_ns, State.LOST, contact_area_px=area, stage_s=watch.stage_s, skipped=("filter",)
            )
        watch.lap("axis")
        published_deg = self._filter.update(angle_deg)
        watch.lap("filter")
        if angle_deg is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s)
        return SlipSample(time_ns, State.TRACKING, published_deg, contact_area_px=area, stage_s=watch.stage_s)
