"""The slip estimator: frame -> contact -> gradient -> alignment to a keyframe -> angle, rate, sigma.

One tactile sensor, frame by frame, causal. A contact's first stable frame becomes the keyframe to
which later frames are aligned, so errors do not add up over frames. Where the contact has changed
too much for that (it grew, slid off the gel's edge, turned far), the newest frame that fits becomes
a further keyframe, whose angle stays as uncertain as it was when it was taken.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.gate import ContactGate, Region
from rig.tactile.contact.relative import RelativeDifference, work_size
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State
from rig.tactile.slip.axis_check import AxisAnchor, anchor, long_axis
from rig.tactile.slip.gradient import Box, LearntGradientMap, learn_map
from rig.tactile.slip.height import Field, Gradient
from rig.tactile.slip.kalman import RateFilter
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.registration import MAX_ITERATIONS
from rig.tactile.slip.sampling import BROAD_REACH_PX, GradientField
from rig.tactile.slip.settling import Settling
from rig.tactile.slip.tracker import KeyframeTracker, Tracked
from rig.tactile.slip.uncertainty import angle_variance
from rig.tactile.stopwatch import Stopwatch

NOISE_BLUR_PX = 0.7
BOX_MARGIN_PX = BROAD_REACH_PX + 3
# Below this contrast a turn leaves no trace (smooth balls and rings reach 0.15, ovals of axis ratio
# 1.3 about 0.2) and the angle is refused. Where the image's edge cuts a ball off, the map learnt on
# the rest makes up a direction (real balls reach 0.6).
LEAST_CONTRAST, LEAST_CONTRAST_CLIPPED = 0.18, 0.7
# A refused contact is looked at again after so many frames.
PATIENCE_FRAMES = 12
# A contact gone for longer is a new grasp; one that fits no keyframe for longer gets a new one.
FORGET_S, GIVE_UP_S = 0.5, 0.25
# What is not known of a turn that nobody saw.
UNSEEN_RAD = math.radians(30.0)
# A sigma follows what one frame says of it over this time: two fingertips are weighed by it, and a
# weight that jumps makes the fused angle jump.
SIGMA_PACE_S = 0.15
OUTSIDE, ITERATIONS = "gradient outside the contact", "iterations after the last change"
AXIS = "axis check"
"""What a frame with a contact can do without."""


class SlipEstimator(FreshFrameEstimator):
    """The estimator `slip`.

    background: (H, W, 3) uint8 RGB, a frame without contact. aspect: width over height of a pixel
    on the gel, from `rig calibrate tactile`; None where unknown (taken as 1, with a larger sigma).
    skip: leave out what a frame does not need; without it the answers are the same, later.

    sigma_deg is of the turn since the contact settled, when its keyframe was taken. shift_px counts
    from there too.
    """

    stages = ("contact", "gradient", "alignment", AXIS, "filter")

    def __init__(self, background: Image, aspect: float | None = None, skip: bool = True) -> None:
        super().__init__(background.shape)
        self._skip = skip
        self._aspect_known = aspect is not None
        size = work_size(background.shape, aspect or 1.0)
        self._px_per_work = background.shape[0] / size[1]
        self._light = RelativeDifference(background, size)
        self._gate = ContactGate()
        self._filter = RateFilter()
        self._work: Image | None = None
        self._seen_ns: int | None = None
        self._fitted_ns = 0
        self._angle_rad, self._variance, self._unseen = 0.0, 0.0, 0.0
        self._answered = False
        self._anchor: AxisAnchor | None = None
        self._release()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        work = self._light.reduced(image)
        if self._last is not None and self._work is not None and np.array_equal(work, self._work):
            return self._repeated(self._last, time_ns)
        self._work = work
        difference = np.asarray(cv2.GaussianBlur(self._light.of(work), (0, 0), NOISE_BLUR_PX), np.float32)
        region = self._gate.find(difference)
        watch.lap("contact")
        if region is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        if self._seen_ns is not None and time_ns - self._seen_ns > FORGET_S * NS_PER_S:
            self._release()
        self._seen_ns = time_ns
        state, tracked = self._followed(difference, region, time_ns, watch)
        sample = SlipSample(
            time_ns, state, contact_area_px=region.area_px * self._px_per_work**2, stage_s=watch.stage_s
        )
        if tracked is None:
            return sample
        return self._answer(sample, tracked, watch)

    def _followed(
        self, difference: Field, region: Region, time_ns: int, watch: Stopwatch
    ) -> tuple[State, Tracked | None]:
        """Return the state and, where there is an answer, the pose."""
        renewed = self._settling.update(region)
        begun = False
        if renewed or (self._grasp is None and self._patience <= 0):
            begun = self._begin(difference, region)
            watch.lap("keyframe")
        if self._grasp is None or self._map is None:
            self._patience -= 1
            return State.UNOBSERVABLE, None
        box = _box(region.mask) if self._skip else None
        gradient = self._map.apply(difference, box)
        watch.lap("gradient")
        expected = self._angle_rad if begun else self._filter.predicted(time_ns / NS_PER_S)
        field = GradientField(gradient, region.mask, box)
        tracked = self._grasp.track(field, expected)
        if tracked is None or not tracked.good:
            tracked = self._grasp.search(field) or tracked
        watch.lap("alignment")
        if tracked is None:
            self._lose(time_ns)
            return State.LOST, None
        self._fitted_ns = time_ns
        rekeyed = begun and self._answered
        if not self._skip:
            long_axis(region.mask)
            watch.lap(AXIS)
        if not tracked.good:
            rekeyed = self._add_key(gradient, region, tracked) or rekeyed
            watch.lap("keyframe")
        return State.REKEYED if rekeyed else State.TRACKING, tracked

    def _add_key(self, gradient: Gradient, region: Region, tracked: Tracked) -> bool:
        """Take a further keyframe of this frame, if a turn leaves a trace in it."""
        frame = make_keyframe(gradient, region.mask)
        if self._grasp is None or frame is None or not _observable(frame):
            return False
        angle, variance = tracked.pose.angle_rad, angle_variance(tracked, self._aspect_known)
        if self._anchor is not None:
            angle, variance = self._anchor.corrected(region.mask, angle, variance)
        self._grasp.add_key(frame, replace(tracked.pose, angle_rad=angle), variance)
        return True

    def _answer(self, sample: SlipSample, tracked: Tracked, watch: Stopwatch) -> SlipSample:
        variance = angle_variance(tracked, self._aspect_known)
        steady = self._variance if self._answered and sample.state is State.TRACKING else variance
        self._variance = steady + self._pace(sample.time_ns) * (variance - steady)
        self._answered = True
        sigma = max(tracked.alignment.noise_rad, 1e-5)
        angle = self._filter.update(sample.time_ns / NS_PER_S, tracked.pose.angle_rad, sigma)
        self._angle_rad = angle
        self._point_px = tracked.pose.point_px
        shift = (self._point_px - self._origin_px) * self._px_per_work
        watch.lap("filter")
        return replace(
            sample,
            skipped=self._left_out(tracked),
            angle_deg=math.degrees(angle),
            sigma_deg=math.degrees(math.sqrt(self._variance)),
            unseen_deg=math.degrees(math.sqrt(self._unseen)),
            rate_deg_s=math.degrees(self._filter.rate_rad_s),
            shift_px=(shift.real, shift.imag),
        )

    def _pace(self, time_ns: int) -> float:
        """Return the weight of a frame's own variance."""
        elapsed_s = (time_ns - self._last.time_ns) / NS_PER_S if self._last is not None else math.inf
        return 1.0 - math.exp(-max(elapsed_s, 0.0) / SIGMA_PACE_S)

    def _left_out(self, tracked: Tracked) -> tuple[str, ...]:
        """Name what this frame did not need."""
        if not self._skip:
            return ()
        early = tracked.alignment.iterations < MAX_ITERATIONS
        return (OUTSIDE, ITERATIONS, AXIS) if early else (OUTSIDE, AXIS)

    def _repeated(self, last: SlipSample, time_ns: int) -> SlipSample:
        """Answer for a frame that is the last one again: nothing was learnt but that time passed."""
        if last.angle_deg is None:
            return replace(last, time_ns=time_ns, stage_s={}, skipped=self.stages)
        angle_deg = math.degrees(self._filter.predicted(time_ns / NS_PER_S))
        sigma_deg = math.hypot(last.sigma_deg or 0.0, angle_deg - last.angle_deg)
        return replace(
            last, time_ns=time_ns, angle_deg=angle_deg, sigma_deg=sigma_deg, stage_s={}, skipped=self.stages
        )

    def _begin(self, difference: Field, region: Region) -> bool:
        """Start from a keyframe of this frame; False where a turn would leave no trace in it."""
        self._patience = PATIENCE_FRAMES
        learnt = learn_map(difference, region.mask)
        frame = None if learnt is None else make_keyframe(learnt.apply(difference), region.mask)
        if frame is None or not _observable(frame):
            self._grasp, self._map = None, None
            return False
        moved = self._point_px - self._origin_px if self._grasp is not None else 0j
        if self._settling.settled:
            self._anchor_to_axis(region.mask)
        # Until it settles, a contact has not turned yet: the zero is that of its latest keyframe.
        self._map, self._grasp = learnt, KeyframeTracker(frame, self._angle_rad, self._unseen, not self._skip)
        self._point_px, self._origin_px = frame.center_px, frame.center_px - moved
        return True

    def _anchor_to_axis(self, mask: Image) -> None:
        """Note the axis of the first settled contact; a later one is brought back to it."""
        if self._anchor is None:
            self._anchor = anchor(mask, self._angle_rad)
        else:
            self._angle_rad, self._unseen = self._anchor.corrected(mask, self._angle_rad, self._unseen)

    def _lose(self, time_ns: int) -> None:
        """Begin anew where nothing has fitted for too long; the turn in between was not seen."""
        if not self._settling.settled:
            # It has only grown: the next frame gets a keyframe of its own.
            self._settling.renew()
        elif time_ns - self._fitted_ns > GIVE_UP_S * NS_PER_S:
            self._release()

    def _release(self) -> None:
        """Let go of a grasp: the next contact starts where this one was last seen."""
        if self._answered and self._settling.settled:
            self._unseen = self._variance + UNSEEN_RAD**2
        self._grasp: KeyframeTracker | None = None
        self._map: LearntGradientMap | None = None
        self._settling = Settling()
        self._patience = 0
        self._point_px = self._origin_px = 0j
        self._filter.restart()


def _box(mask: Image) -> Box:
    """Return the box around a mask with room for sharpening, interpolation and slopes at its edge."""
    left, top, width, height = cv2.boundingRect(mask)
    right, bottom = left + width + BOX_MARGIN_PX, top + height + BOX_MARGIN_PX
    left, top = max(left - BOX_MARGIN_PX, 0), max(top - BOX_MARGIN_PX, 0)
    return left, top, min(right, mask.shape[1]) - left, min(bottom, mask.shape[0]) - top


def _observable(frame: Keyframe) -> bool:
    return frame.contrast >= (LEAST_CONTRAST_CLIPPED if frame.clipped else LEAST_CONTRAST)
