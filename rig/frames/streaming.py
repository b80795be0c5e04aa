"""Angles of one sensor frame by frame, as the frames are captured."""

import warnings
from dataclasses import replace

import numpy as np

from drivers import arguments
from drivers.clock import NS_PER_S, to_ns
from drivers.errors import InputError
from drivers.formats import MAX_TIME_S
from drivers.types import Image
from rig.frames.slip_alarm import SlipAlarm
from rig.lift.object_angle import ZERO_S, TipTrack
from rig.tactile.contact.background_check import TAKE_AGAIN, BackgroundCheck
from rig.tactile.sample import FROZEN, MAX_SIDE_PX, SlipSample, State, TactileEstimator, check_frame

_MAX_NS = round(MAX_TIME_S * NS_PER_S)


class StreamingEstimator:
    """An estimator for the frames of one sensor, one call per frame.

    It drives the estimator and sets the reference as a lift of the rig does: the same frames, times and
    reference give the same angles bit for bit. estimator: made for this sensor. shape: of its frames,
    (H, W, 3). sign: +1, or -1 for a fingertip that sees the object from behind. each_contact: whether to set
    the reference at the first angle of each contact, and again when the contact has settled.
    """

    def __init__(
        self, estimator: TactileEstimator, shape: tuple[int, ...], sign: int = 1, each_contact: bool = False
    ) -> None:
        if isinstance(estimator, type) or not callable(getattr(estimator, "update", None)):
            raise arguments.refusal("StreamingEstimator: estimator", estimator, "one with a method update")
        if not isinstance(shape, tuple) or len(shape) != 3:
            raise arguments.refusal("StreamingEstimator: shape", shape, "(H, W, 3)")
        sizes = [arguments.whole("StreamingEstimator: shape", size, 1, MAX_SIDE_PX) for size in shape]
        check_frame(np.empty(sizes, np.uint8))
        self._estimator, self._shape = estimator, shape
        self._track, self._alarm = TipTrack(checked_sign("sign", sign)), SlipAlarm()
        self._each_contact, self._settled = arguments.flag("each_contact", each_contact), False
        self._newest_ns: int | None = None
        self._check: BackgroundCheck | None = None
        self._warned: set[bool] = set()
        self.misfit = False
        """Whether the frames have no angle, because they do not fit the background or are compressed."""
        self.news = ""
        """A text for the user if the sensor has frozen since the frame before."""

    @property
    def track(self) -> TipTrack:
        """The newest samples with their sign and zero, in the form that `rig.lift.object_angle` reads."""
        return self._track

    @property
    def settled(self) -> bool:
        """Whether the contact has settled, and its angle since then is known: a reference is good now."""
        return self._settled

    @property
    def slips_s(self) -> tuple[float, ...]:
        """Times of the frames in which the slip alarm was raised, s; the newest 20."""
        return tuple(time_ns / NS_PER_S for time_ns in self._alarm.raised_ns)

    def update(self, image: Image, time_s: float) -> SlipSample:
        """Estimate the angle in the next frame.

        image: (H, W, 3) uint8 RGB, of the background's size; it is copied. time_s: capture time in s of any
        clock. The angle of the returned sample is the rotation since the reference, counter-clockwise
        positive as seen, times the sign. Before a reference is set, its zero is the estimator's own, for
        `slip` the first contact; that of shift_px always is.

        A frame with the time of the previous frame is not estimated: its state is "lost". Raises `InputError`
        for another shape or type and for a time that is not finite or goes back; the estimator can be used
        afterwards as if the call had not been made. Warns (`UserWarning`) if the sensor has frozen.
        """
        check_frame(image, self._shape)
        time_ns = _as_ns("update", time_s)
        if self._newest_ns is not None and time_ns < self._newest_ns:
            newest_s = self._newest_ns / NS_PER_S
            raise InputError(
                f"the frame's time {time_s:.6f} s is before the last one's, {newest_s:.6f} s: give frames in "
                "order, or make another estimator for another recording"
            )
        answer = self._next(image.copy(), time_ns)
        if self.news:
            warnings.warn(self.news, stacklevel=2)
        return answer

    def update_at(self, image: Image, time_ns: int) -> SlipSample:
        """Do the same as `update` for a time in ns, without copying the image: do not modify it later.

        A time that goes back is accepted: the clock of a live stream may be set back.
        """
        check_frame(image, self._shape)
        return self._next(image, arguments.whole("update_at: time_ns", time_ns, -_MAX_NS, _MAX_NS))

    def _next(self, image: Image, time_ns: int) -> SlipSample:
        if self._check is not None:
            self._check.add(image, time_ns)
            self._warn(self._check)
        self._newest_ns = time_ns
        sample = self._estimator.update(image, time_ns)
        arguments.instance("StreamingEstimator: the result of update", sample, SlipSample, "a rig.SlipSample")
        sample = sample.without_angle() if self.misfit else sample
        kept = self._track.samples
        froze = sample.state is State.FROZEN and not (kept and kept[-1].state is State.FROZEN)
        self.news = FROZEN if froze else ""
        kept.append(sample)
        while kept[0].time_ns < time_ns - to_ns(2 * ZERO_S):
            del kept[0]
        slip = self._alarm.update(sample)
        self._settle(sample)
        zero_deg = 0.0 if self._track.zero_deg is None else self._track.zero_deg
        turned = sample.since_zero(self._track.sign, zero_deg, self._track.zero_sample)
        return replace(turned, slip=slip)

    def check_background(self, background: Image) -> None:
        """Check the background, now and in later frames.

        Warns once (`UserWarning`) if it looks like a contact, and once if it does not fit the frames; these
        then have no angle.
        """
        check_frame(background, self._shape)
        self._check = BackgroundCheck(background)
        self._warn(self._check)

    def set_reference(self, time_s: float | None = None) -> None:
        """Set the zero to the mean angle of the last 0.4 s before a time, and arm the slip alarm.

        time_s: at most 0.4 s before the newest frame; by default just after it. Raises `InputError` if no
        frame in these 0.4 s has an angle; the old reference is kept in that case.
        """
        now_ns = (self._newest_ns or 0) + 1 if time_s is None else _as_ns("set_reference", time_s)
        before = self._track.zero_deg, self._track.zero_sample
        self._track.set_zero(now_ns)
        if self._track.zero_deg is None:
            self._track.zero_deg, self._track.zero_sample = before
            raise InputError(
                f"reference: no frame in the {ZERO_S:g} s before it has an angle: press an object on the "
                "gel, and set the reference while it rests"
            )
        self._alarm.arm()

    def _warn(self, check: BackgroundCheck) -> None:
        self.misfit = bool(check.misfit)
        if check.doubt and self.misfit not in self._warned:
            self._warned.add(self.misfit)
            warnings.warn(check.doubt_with(TAKE_AGAIN), stacklevel=4)

    def _settle(self, sample: SlipSample) -> None:
        """Note whether the contact has settled, and set the reference if one is due."""
        if not sample.shows_contact:
            return
        before, self._settled = (
            self._settled,
            bool(sample.settled) and (self._settled or sample.angle_deg is not None),
        )
        if not self._each_contact:
            return
        if before and not self._settled:
            self._track.zero_deg = self._track.zero_sample = None
        if sample.angle_deg is not None and (self._track.zero_deg is None or self._settled > before):
            self._track.zero_deg, self._track.zero_sample = sample.angle_deg, sample


def checked_sign(name: str, sign: int) -> int:
    """Return +1 or -1. Raises `InputError`."""
    plain = arguments.whole(name, sign, -1, 1)
    if plain == 0:
        raise arguments.refusal(name, sign, "1, or -1 for a fingertip that sees the object from behind")
    return plain


def _as_ns(where: str, time_s: float) -> int:
    return round(arguments.number(f"{where}: time_s", time_s, -MAX_TIME_S, MAX_TIME_S) * NS_PER_S)
