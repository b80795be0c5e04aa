"""The slip estimator: frame -> contact -> gradient -> alignment to a keyframe -> angle, rate, sigma.

One tactile sensor, frame by frame, causal. The first stable frame of a contact becomes the keyframe to which
later frames are aligned, so errors do not add up over frames. If the contact has changed too much (it grew,
slid off the edge of the gel, or rotated far), the newest frame that fits becomes a further keyframe. The
angle of a keyframe keeps the uncertainty at the time of the keyframe.
"""

import math
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from calibration.gel.look import GelLook
from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.blas_threads import one_blas_thread
from rig.tactile.contact.gate import ContactGate
from rig.tactile.contact.relative import Light, RelativeDifference, full_area, work_size
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, Stopwatch
from rig.tactile.settling import NEW_GRASP_NS
from rig.tactile.slip.compiling import compile_all
from rig.tactile.slip.following import TEXTURE_STAGE, ContactFollower, SeenContact, TextureOnDemand
from rig.tactile.slip.fused_angle import FirstAnswer, Fused, FusedAngle, JointAngle
from rig.tactile.slip.gel_marks import GelMarks, found_marks
from rig.tactile.slip.gradient import CalibratedSlopes, learn_map
from rig.tactile.slip.joint_tracker import JointTracker
from rig.tactile.slip.kalman import RateFilter
from rig.tactile.slip.parameters import FUSION, MOTION
from rig.tactile.slip.registration import MAX_ITERATIONS
from rig.tactile.slip.settling import Tearing
from rig.tactile.slip.texture import TextureField, fine_scale
from rig.tactile.slip.tracker import Tracked
from rig.tactile.slip.turning import shipped_turning

NOISE_BLUR_PX = 0.7
JOINT_STAGE = "joint alignment"
OUTSIDE, ITERATIONS = "gradient outside the contact", "iterations after the last change"
"""Stages that can be skipped for a frame with contact."""


class SlipEstimator(FreshFrameEstimator):
    """The estimator `slip`.

    background: (H, W, 3) uint8 RGB, a frame without contact. aspect: width over height of a pixel
    on the gel, from `rig calibrate tactile`; None if unknown (1 is assumed, with a larger sigma).
    skip: skip stages that a frame does not need; the samples are the same without it, but take longer.
    look: of this sensor, from presses of a ball; None to learn the map from each contact.

    sigma_deg is of the turn since the contact settled, when its keyframe was taken. shift_px counts
    from there too.
    """

    follows_motion = True
    stages = ("contact", "gradient", TEXTURE_STAGE, "alignment", JOINT_STAGE, "filter")

    def __init__(
        self,
        background: Image,
        aspect: float | None = None,
        skip: bool = True,
        look: GelLook | None = None,
    ) -> None:
        super().__init__(background.shape)
        compile_all()
        self._skip = skip
        size = work_size(background.shape, aspect or 1.0)
        self._px_per_work = (background.shape[1] / size[0], background.shape[0] / size[1])
        self._light = RelativeDifference(background, size)
        self._scale = fine_scale(background.shape, size)
        fine = (self._scale * size[0], self._scale * size[1])
        self._fine_light = RelativeDifference(background, fine)
        marked = found_marks(background, fine)
        self._marks, self._fine_marks = GelMarks(marked, size), GelMarks(marked, fine)
        self._turning = shipped_turning()
        self._gate = ContactGate()
        self._tearing = Tearing()
        self._filter = RateFilter()
        self._work = np.zeros(0, np.uint8)
        self._computed: SlipSample | None = None
        self._seen_ns: int | None = None
        self._first_variance: float | None = None
        self._variance: float | None = None
        self._slopes = None if look is None else CalibratedSlopes(look, background, size)
        learn = learn_map if self._slopes is None else self._slopes.map
        self._joint, self._fusion = JointTracker(learn), FusedAngle()
        self._waiting: tuple[SeenContact, float] | None = None
        self._follower = ContactFollower(self._filter, aspect is not None, skip, learn)

    def gripped_further(self) -> None:
        """Take a keyframe of the present contact at its angle, because older keyframes fit it less well."""
        self._follower.gripped_further()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        with one_blas_thread():
            return self._estimated(image, time_ns)

    def _estimated(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        work = self._light.reduced(image)
        if self._computed is not None and np.array_equal(work, self._work):
            return self._repeated(self._computed, time_ns)
        self._work = work
        self._computed = self._fresh(image, work, time_ns, watch)
        return self._computed

    def _fresh(self, image: Image, work: Image, time_ns: int, watch: Stopwatch) -> SlipSample:
        light = self._light.light_of(work)
        clean = self._marks.mended(self._light.of(work, light))
        difference = np.asarray(cv2.GaussianBlur(clean, (0, 0), NOISE_BLUR_PX), np.float32)
        region = self._gate.find(difference)
        torn = self._tearing.update(region)
        watch.lap("contact")
        if region is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        if self._seen_ns is not None and time_ns - self._seen_ns > NEW_GRASP_NS:
            self._release(time_ns)
        self._seen_ns = time_ns
        texture = TextureOnDemand(partial(self._texture, image, light))
        pattern = difference if self._slopes is None else self._slopes.of(difference, region.mask)
        seen = SeenContact(pattern, texture, region, torn, time_ns)
        state, tracked = self._follower.follow(seen, watch)
        sample = SlipSample(
            time_ns,
            state,
            contact_area_px=full_area(region.area_px, work.shape, image.shape),
            stage_s=watch.stage_s,
            settled=self._follower.settled,
        )
        if state is State.UNOBSERVABLE:
            return sample
        first = None if tracked is None else self._first_answer(sample, tracked)
        joint = self._joint_angle(seen, state, first)
        watch.lap(JOINT_STAGE)
        fused = self._fusion.update(time_ns / NS_PER_S, first, joint)
        if fused is None:
            return sample
        if tracked is None:
            sample = replace(sample, state=State.TRACKING)
        return self._answer(sample, fused, tracked, watch)

    def _release(self, time_ns: int) -> None:
        """Forget the contact."""
        self._follower.release(time_ns)
        self._joint.release()
        self._waiting = None
        self._fusion.released()

    def _texture(self, image: Image, light: Light) -> TextureField:
        fine = self._fine_marks.mended(self._fine_light.of(self._fine_light.reduced(image), light))
        return TextureField(fine, self._scale, self._turning.counts(fine, self._scale))

    def _first_answer(self, sample: SlipSample, tracked: Tracked) -> FirstAnswer:
        """Return the filtered answer of the keyframe tracker."""
        total = tracked.variance + tracked.shape_doubt
        variance = self._steady(self._first_variance, total, sample)
        noise = max(tracked.noise_rad, 1e-5)
        angle = self._filter.update(sample.time_ns / NS_PER_S, tracked.pose.angle_rad, noise)
        self._follower.answered(angle, variance, tracked)
        self._first_variance = variance
        kept = min(tracked.inherited, variance)
        leads = tracked.fit is not None
        rate = self._filter.rate_rad_s
        # The variance of this frame; the reported one is averaged over time.
        sigma = math.sqrt(total)
        return FirstAnswer(angle, rate, sigma, kept, tracked.shape_doubt, leads, tracked.corrected_rad)

    def _joint_angle(self, seen: SeenContact, state: State, first: FirstAnswer | None) -> JointAngle | None:
        """Return the joint tracker's angle in this frame; None if the tracker does not run.

        While the slopes lead, the fused angle does not depend on it. The tracker then processes a frame, and
        takes its keyframes, during later frames without texture or a new keyframe, so that no frame needs the
        time of all stages.
        """
        looked = seen.texture.computed is not None
        if first is None or first.texture_leads:
            self._catch_up()
            return self._joint.follow(seen) if first is None or looked else None
        if looked:
            self._catch_up()
            self._waiting = seen, first.angle_rad
        elif state is not State.REKEYED and not self._catch_up():
            self._joint.take_keyframe()
        return None

    def _catch_up(self) -> bool:
        """Let the joint tracker process the waiting frame; return whether there was one."""
        if self._waiting is None:
            return False
        (seen, first_rad), self._waiting = self._waiting, None
        joint = self._joint.follow(seen)
        if joint is not None:
            self._fusion.take_late(joint, first_rad)
        return True

    def _answer(
        self, sample: SlipSample, fused: Fused, tracked: Tracked | None, watch: Stopwatch
    ) -> SlipSample:
        self._variance = self._steady(self._variance, fused.variance, sample)
        shift = self._follower.point_px - self._follower.origin_px
        watch.lap("filter")
        return replace(
            sample,
            skipped=() if tracked is None else self._left_out(tracked),
            angle_deg=math.degrees(fused.angle_rad),
            sigma_deg=math.degrees(math.sqrt(self._variance)),
            unseen_deg=math.degrees(math.sqrt(min(fused.inherited, self._variance))),
            rate_deg_s=math.degrees(fused.rate_rad_s),
            shift_px=(shift.real * self._px_per_work[0], shift.imag * self._px_per_work[1]),
        )

    def _steady(self, before: float | None, variance: float, sample: SlipSample) -> float:
        """Return the variance to report, averaged from that of this frame and the previous one."""
        if before is None or self._last is None or sample.state is State.REKEYED:
            return variance
        elapsed_s = max(sample.time_ns - self._last.time_ns, 0) / NS_PER_S
        return variance + math.exp(-elapsed_s / FUSION.sigma_pace_s) * (before - variance)

    def _left_out(self, tracked: Tracked) -> tuple[str, ...]:
        """Return the names of the stages that this frame did not need."""
        if not self._skip:
            return ()
        early = tracked.alignment is not None and tracked.alignment.iterations < MAX_ITERATIONS
        return (OUTSIDE, ITERATIONS) if early else (OUTSIDE,)

    def _repeated(self, last: SlipSample, time_ns: int) -> SlipSample:
        """Return the sample of a frame that repeats the previous one, without computing it again."""
        if last.angle_deg is None:
            return replace(last, time_ns=time_ns, stage_s={}, skipped=self.stages)
        ahead_s = min((time_ns - last.time_ns) / NS_PER_S, MOTION.horizon_s)
        angle_deg = last.angle_deg + (last.rate_deg_s or 0.0) * ahead_s
        sigma_deg = math.hypot(last.sigma_deg or 0.0, angle_deg - last.angle_deg)
        return replace(
            last, time_ns=time_ns, angle_deg=angle_deg, sigma_deg=sigma_deg, stage_s={}, skipped=self.stages
        )
