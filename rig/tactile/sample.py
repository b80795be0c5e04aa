"""The interface of estimators: frames in, one `SlipSample` per frame out, with its faults and run times."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar, Protocol

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, plural
from drivers.tally import LONGEST_STEP_NS, SELDOM_NS, PictureNews, StreamTimes
from drivers.types import ArmState, Image
from drivers.values import short_repr
from rig.tactile.settling import SettlingByArea

MIN_SIDE_PX, MAX_SIDE_PX = 8, 4096
"""Smallest and largest side of a tactile frame."""
MOST_ELONGATED = 40
"""Largest ratio of the sides; the reduced copy of a narrower frame would be less than 2 px wide."""


class State(StrEnum):
    """State of the estimate for a frame; the names are part of the file format."""

    NO_CONTACT = "no_contact"
    TRACKING = "tracking"
    REKEYED = "rekeyed"
    UNOBSERVABLE = "unobservable"
    LOST = "lost"
    FROZEN = "frozen"


@dataclass(frozen=True, slots=True)
class SlipSample:
    """The estimate for one frame.

    time_ns: capture time of the frame. angle_deg: image angle, counter-clockwise positive in the image (theta
    = -atan2(dy, dx)), unwrapped over time; None if the estimator refuses the frame. Its zero is arbitrary, so
    only differences are meaningful. sigma_deg: standard deviation of the angle; None if the method has none.
    unseen_deg: part of sigma_deg that is due to rotations while the contact was lost. rate_deg_s: rotation
    rate; None if unknown. shift_px: shift of the contact since the reference, x to the right and y down; None
    if unknown. contact_area_px: contact area in pixels of the frame, 0 without contact. stage_s: run time per
    stage, s. skipped: names of the stages that were not needed. fault: error of a foreign estimator that
    raised an exception or returned an invalid sample; the state is then `lost`. jumped: whether the time of
    the frame is implausible in its stream, or not after that of the frame before; the frame is not used, and
    its state is `lost`, or `no_contact` if it was so before. settled: whether the contact has settled, so
    that the angle of this frame, if it has one, is a good zero: later angles of this contact differ from it
    by the measured rotation. It stays True until the next contact. If an estimator leaves it None,
    `FreshFrameEstimator` sets it by the default rule, see `SettlingByArea`.

    The rig sets the following in samples that it passes on. slip: whether the slip alarm is on, see
    `rig.frames.slip_alarm`; None if unknown. cost_s: wall time of the computation; None for a frame that
    could not be read. disagreement: in a fused sample, why the fingertips rotate differently; None if they
    agree.
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
    settled: bool | None = None
    slip: bool | None = None
    cost_s: float | None = None
    disagreement: str | None = None

    __repr__ = short_repr

    @property
    def time_s(self) -> float:
        """Capture time of the frame, s."""
        return self.time_ns / NS_PER_S

    @property
    def shows_contact(self) -> bool:
        """Whether the frame shows a contact; an estimator need not report its area."""
        return self.contact_area_px > 0.0 or self.angle_deg is not None

    @property
    def estimated(self) -> bool:
        """Whether the frame was processed with a contact; other frames need nearly no time."""
        return not (self.jumped or self.state in (State.NO_CONTACT, State.FROZEN))

    def without_angle(self) -> "SlipSample":
        """Return the sample without its angle, in the state `lost`; a sample without one is unchanged."""
        if self.angle_deg is None:
            return self
        return replace(
            self,
            state=State.LOST,
            angle_deg=None,
            sigma_deg=None,
            unseen_deg=0.0,
            rate_deg_s=None,
            shift_px=None,
        )

    def since_zero(self, sign: int, zero_deg: float | None, zero: "SlipSample | None") -> "SlipSample":
        """Return the sample with the rotation since a zero as its angle; without `zero_deg` it has no angle.

        sign: +1 or -1, from the image angle to the object's. zero: sample at the zero. Unobserved rotations
        before both samples cancel in sigma_deg; those between them contribute.
        """
        angle, sigma = None, None
        if self.angle_deg is not None and zero_deg is not None:
            angle, sigma = sign * (self.angle_deg - zero_deg), self.sigma_deg
            if sigma is not None and zero is not None:
                seen = sigma**2 - self.unseen_deg**2
                sigma = math.sqrt(max(seen, 0.0) + abs(self.unseen_deg**2 - zero.unseen_deg**2))
        rate = None if self.rate_deg_s is None else sign * self.rate_deg_s
        return replace(self, angle_deg=angle, sigma_deg=sigma, rate_deg_s=rate)


class TimedImage(Protocol):
    """A frame with its capture time. image: (H, W, 3) uint8 RGB, None if it could not be read."""

    @property
    def image(self) -> Image | None: ...

    @property
    def time_ns(self) -> int: ...


class TactileEstimator(Protocol):
    """Turns the frames of one tactile sensor into slip samples, one call per frame."""

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB captured at `time_ns`; causal, never raises on content."""
        ...

    def arm(self, state: ArmState) -> None:
        """Pass a state of the arm that was sampled before the next frames; most estimators ignore it."""

    def gripped_further(self) -> None:
        """Notify the estimator that the fingers have closed further, so that the contact has changed.

        Most estimators ignore it.
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


FROZEN = "the sensor repeats its picture: it has frozen, and there is no angle; check its cable, replug it"
"""Text for the user about frames with the state `frozen`."""
ROUNDING = 3
"""Largest difference of the colours of a grey pixel after JPEG or video compression, grey levels."""
NO_COLOUR = (
    "the images have no colour, but slip and the networks see slopes by the coloured light of the gel: "
    "angles may be wrong; set the camera to colour"
)


def has_colour(image: Image) -> bool:
    """Whether the colours of an image (H, W, 3) differ, by more than the rounding of an encoder."""
    return bool((image.max(axis=2) - image.min(axis=2)).max() > ROUNDING)


SET_BACK_STEP_NS = NS_PER_S // 30
"""Assumed time since the last frame when a stream's clock was set back: two frames at 60 Hz."""


class FreshFrameEstimator(TactileEstimator):
    """Base class of estimators that process each frame once, with increasing times.

    A frame that is not newer than the previous one (repeated, or delivered late), or whose time jumps
    (`drivers.tally.StreamTimes`), is not processed and gets the state `lost` without an angle. If the next
    frame agrees with a jumped time, the stream continues from there: after a pause or, if its clock was set
    back, as if `SET_BACK_STEP_NS` had passed. In a stream of frames far apart (`StreamTimes.sparse`) an
    estimator that follows the motion loses the contact, except in its first frame. A frame of a frozen source
    (`drivers.tally.PictureNews`) is not processed either; its state is `frozen`. shape: of the frames,
    (H, W, 3); None for any.
    """

    follows_motion: ClassVar[bool] = False
    """Whether the angle depends on the frame before, and not on the image alone."""

    stages: ClassVar[tuple[str, ...]]
    """Names of the processing stages, in order."""

    def __init__(self, shape: tuple[int, ...] | None = None) -> None:
        self._shape = shape
        self._last: SlipSample | None = None
        self._times, self._settling, self._news = StreamTimes(), SettlingByArea(), PictureNews(SELDOM_NS)
        self._set_back_ns = 0

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises only `InputError`, for another shape or type."""
        check_frame(image, self._shape)
        if not self._times.follows(time_ns):
            return SlipSample(time_ns, State.LOST, skipped=self.stages, jumped=True)
        last = self._last
        if last is not None and last.time_ns - (time_ns + self._set_back_ns) > LONGEST_STEP_NS:
            self._set_back_ns = last.time_ns + SET_BACK_STEP_NS - time_ns
        now_ns = time_ns + self._set_back_ns
        if last is not None and now_ns <= last.time_ns:
            state = State.NO_CONTACT if last.state is State.NO_CONTACT else State.LOST
            return SlipSample(last.time_ns - self._set_back_ns, state, skipped=self.stages, jumped=True)
        self._news.add(image, now_ns)
        if self._news.frozen:
            settled = None if last is None else last.settled
            self._last = SlipSample(now_ns, State.FROZEN, skipped=self.stages, settled=settled)
            return replace(self._last, time_ns=time_ns)
        held = last is not None and last.state is not State.NO_CONTACT
        sample = self._estimate(image, now_ns)
        if held and self.follows_motion and self._times.sparse and sample.angle_deg is not None:
            area = sample.contact_area_px
            sample = SlipSample(now_ns, State.LOST, contact_area_px=area, stage_s=sample.stage_s)
        if sample.settled is None:
            area_px = sample.contact_area_px or float(sample.shows_contact)
            sample = replace(sample, settled=self._settling.update(area_px, now_ns))
        self._last = sample
        return replace(sample, time_ns=time_ns) if self._set_back_ns else sample

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from a frame that is newer than all frames before."""
        raise TypeError(f"{type(self).__name__} does not implement _estimate")


@dataclass(frozen=True, slots=True)
class EstimatorFaults:
    """The number of frames on which an estimator failed, and the fault of the first of them."""

    frames: int
    first: str

    def __str__(self) -> str:
        return (
            f"the estimator failed on {plural(self.frames, 'frame')}, counted as 'lost'; first: {self.first}"
        )


def faults_of(samples: Iterable[SlipSample]) -> EstimatorFaults | None:
    """Return the faults among samples; None if there are none."""
    faults = [sample.fault for sample in samples if sample.fault is not None]
    return EstimatorFaults(len(faults), faults[0]) if faults else None


def together(faults: Sequence[EstimatorFaults]) -> EstimatorFaults:
    """Return the sum of the faults of several parts, in order; there must be at least one."""
    return EstimatorFaults(sum(of.frames for of in faults), faults[0].first)


class Stopwatch:
    """Run time of the stages of one frame, s; used only in reports, never in results."""

    def __init__(self) -> None:
        self.stage_s: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.perf_counter()
        self.stage_s[stage] = self.stage_s.get(stage, 0.0) + now - self._since
        self._since = now
