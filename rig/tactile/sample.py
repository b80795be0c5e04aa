"""What an estimator takes, and what it says about one tactile frame."""

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar, Protocol

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.tally import LONGEST_STEP_NS, StreamTimes
from drivers.types import ArmState, Image
from drivers.values import short_repr

MIN_SIDE_PX, MAX_SIDE_PX = 8, 4096
MOST_ELONGATED = 40
"""Frames are worked on smaller than they are, and nothing would be left of a narrower one."""


class State(StrEnum):
    """What the estimator can claim about a frame (contract: names are fixed)."""

    NO_CONTACT = "no_contact"
    TRACKING = "tracking"
    REKEYED = "rekeyed"
    UNOBSERVABLE = "unobservable"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class SlipSample:
    """The answer for one frame, at the frame's own time.

    angle_deg: image angle, counter-clockwise positive as seen (theta = -atan2(dy, dx)),
    unwrapped over time, None where the estimator refuses. Its zero is the estimator's own: only
    differences mean anything. sigma_deg: one standard deviation, None where the method has
    none. unseen_deg: the part of it that comes from turns while the contact was lost.
    rate_deg_s, shift_px (x right, y down, since the reference): None where unknown.
    contact_area_px: contact area in pixels of the given image, 0 without contact.
    stage_s: wall time spent per stage; skipped: names of the stages that were not needed. fault: what was
    wrong where an estimator that is not the rig's own raised, or told what cannot be; then `lost`. jumped:
    whether the frame's time is implausible in its stream, so that the frame was not used; then `lost`.
    """

    time_ns: int
    state: State
    angle_deg: float | None = None
    sigma_deg: float | None = None
    unseen_deg: float = 0.0
    rate_deg_s: float | None = None
    shift_px: tuple[float, float] | None = None
    contact_area_px: float = 0.0
    stage_s: dict[str, float] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()
    fault: str | None = None
    jumped: bool = False

    __repr__ = short_repr

    def sigma_since(self, zero: "SlipSample | None") -> float | None:
        """Return one standard deviation of the turn between a zero and this, deg; None as sigma_deg.

        What was not seen before both of them does not count, what was not seen in between does.
        """
        if self.sigma_deg is None or zero is None:
            return self.sigma_deg
        seen = self.sigma_deg**2 - self.unseen_deg**2
        return math.sqrt(max(seen, 0.0) + abs(self.unseen_deg**2 - zero.unseen_deg**2))


class TactileEstimator(Protocol):
    """Turns the frames of one tactile sensor into slip samples, one call per frame."""

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB captured at `time_ns`; causal, never raises on content."""
        ...

    def arm(self, state: ArmState) -> None:
        """Take the arm's state, sampled before the next frames; most estimators look at frames alone."""

    def gripped_further(self) -> None:
        """Take note that the fingers have closed further: a contact is another than it was.

        Most estimators look at frames alone.
        """


def check_frame(image: Image, shape: tuple[int, ...] | None = None) -> None:
    """Raise `InputError` unless the image is (H, W, 3) uint8, of the given shape if one is given."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise InputError(f"tactile frame has type {getattr(image, 'dtype', type(image))}: give uint8 RGB")
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < MIN_SIDE_PX:
        raise InputError(f"tactile frame has shape {image.shape}: give (H, W, 3), {MIN_SIDE_PX} px or more")
    if max(image.shape[:2]) > MAX_SIDE_PX:
        raise InputError(f"tactile frame has shape {image.shape}: give {MAX_SIDE_PX} px a side or less")
    if max(image.shape[:2]) > MOST_ELONGATED * min(image.shape[:2]):
        raise InputError(
            f"tactile frame has shape {image.shape}: no side may be {MOST_ELONGATED} times the other"
        )
    if shape is not None and image.shape != shape:
        raise InputError(f"tactile frame has shape {image.shape}, its background {shape}: use one size")


SET_BACK_STEP_NS = NS_PER_S // 30
"""Assumed time since the last frame when a stream's clock was set back: two frames at 60 Hz."""


class FreshFrameEstimator(TactileEstimator):
    """An estimator that looks at each frame once, at a time that only goes forward.

    A frame that is not newer than the one before (repeated, or delivered late) gets the last answer again and
    counts for nothing. A frame whose time jumps (`drivers.tally.StreamTimes`) is `lost` and changes nothing.
    If the next frame agrees with it, the stream is followed from there: after a pause, or, if its clock was
    set back, as if `SET_BACK_STEP_NS` had passed. shape: of the frames, (H, W, 3); any where None.
    """

    stages: ClassVar[tuple[str, ...]]
    """What a frame goes through, in order."""

    def __init__(self, shape: tuple[int, ...] | None = None) -> None:
        self._shape = shape
        self._last: SlipSample | None = None
        self._times = StreamTimes()
        self._set_back_ns = 0

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises `InputError` for another shape or type only."""
        check_frame(image, self._shape)
        if not self._times.follows(time_ns):
            return SlipSample(time_ns, State.LOST, skipped=self.stages, jumped=True)
        last = self._last
        if last is not None and last.time_ns - (time_ns + self._set_back_ns) > LONGEST_STEP_NS:
            self._set_back_ns = last.time_ns + SET_BACK_STEP_NS - time_ns
        now_ns = time_ns + self._set_back_ns
        if last is not None and now_ns <= last.time_ns:
            return replace(last, time_ns=last.time_ns - self._set_back_ns, stage_s={}, skipped=self.stages)
        self._last = self._estimate(image, now_ns)
        return replace(self._last, time_ns=time_ns)

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from a frame that is newer than any before."""
        raise TypeError(f"{type(self).__name__} does not say how it estimates")
