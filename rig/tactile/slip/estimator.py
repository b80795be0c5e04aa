"""The slip estimator: frame -> contact -> slopes and texture -> alignment to keyframes -> angle, rate, sigma.

One tactile sensor, frame by frame, causal.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np

from calibration.gel.look import GelLook
from drivers.types import Image
from rig.tactile.blas_threads import one_blas_thread
from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.contact.gel_marks import found_marks
from rig.tactile.contact.later_marks import LaterMarks
from rig.tactile.contact.relative import RelativeDifference, full_area, smooth, work_size
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, Stopwatch
from rig.tactile.settling import NEW_GRASP_NS
from rig.tactile.slip.all_loops import compile_all
from rig.tactile.slip.gradient import CalibratedSlopes, LearntGradientMap, learn_map
from rig.tactile.slip.height import Field
from rig.tactile.slip.light import Light, Lit
from rig.tactile.slip.report import Report, extrapolate
from rig.tactile.slip.seen import Seen
from rig.tactile.slip.tearing import Tearing
from rig.tactile.slip.texture import Texture, fine_scale
from rig.tactile.slip.texture_stage import TextureStage
from rig.tactile.slip.tracker import Tracker


def _learnt_alone(difference: Field, mask: Image) -> LearntGradientMap | None:
    """Learn the map with one thread of BLAS; besides this only calibrated slopes use it in a frame."""
    with one_blas_thread():
        return learn_map(difference, mask)


class SlipEstimator(FreshFrameEstimator):
    """The estimator `slip`.

    background: (H, W, 3) uint8 RGB, a frame without contact. aspect: width over height of a pixel on the gel,
    from `rig calibrate tactile`; None if unknown, then 1 is assumed. skip: False to compute each stage in
    every frame with contact, also if its result is not needed. look: of this sensor, from presses of a ball;
    None to learn the map from each contact.
    """

    stages = ("contact", "texture", "alignment", "answer")

    def __init__(
        self,
        background: Image,
        aspect: float | None = None,
        skip: bool = True,
        look: GelLook | None = None,
    ) -> None:
        super().__init__(background.shape)
        compile_all()
        size = work_size(background.shape, aspect or 1.0)
        self._skip = skip
        self._report = Report((background.shape[1] / size[0], background.shape[0] / size[1]))
        scale = fine_scale(background.shape, size)
        fine = scale * size[0], scale * size[1]
        marked = found_marks(background, fine)
        self._marks, self._is_fine_due = LaterMarks(marked), False
        self._lit = Lit(RelativeDifference(background, size), marked)
        self._fine_lit = Lit(RelativeDifference(background, fine), marked)
        self._tearing = Tearing()
        self._slopes = None if look is None else CalibratedSlopes(look, background, size)
        self._tracker = Tracker(_learnt_alone if self._slopes is None else self._slopes.map)
        self._texture = TextureStage(self._fine_lit, scale, fine)
        self._work = np.zeros(0, np.uint8)
        self._computed: SlipSample | None = None
        self._seen_ns: int | None = None
        self._gone = False

    def gripped_further(self) -> None:
        """Take a keyframe of the present contact at its angle, because older keyframes fit it less well."""
        if self._tracker.contact is not None:
            self._tracker.contact.keyring.ask()
            self._report.gripped_further()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        fine = self._fine_lit.reduce(image)
        work = self._lit.reduce(fine)
        if self._skip and self._computed is not None and np.array_equal(work, self._work):
            return replace(extrapolate(self._computed, time_ns), stage_s={}, skipped=self.stages)
        self._work, self._computed = work, self._fresh(image, fine, work, time_ns, watch)
        return self._computed

    def _fresh(self, image: Image, fine: Image, work: Image, time_ns: int, watch: Stopwatch) -> SlipSample:
        light = self._lit.light(work)
        planes = self._lit.of(work, light, (0, 0, work.shape[1], work.shape[0]))
        clean = np.asarray(cv2.merge(list(planes)), np.float32)
        difference = smooth(clean)
        region = self._find_contact(difference, fine, light, time_ns)
        torn = self._tearing.update(region)
        watch.lap("contact")
        if region is None:
            self._gone = True
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        # Only frames without contact end a contact: the time between two frames may be as long.
        if self._gone and self._seen_ns is not None and time_ns - self._seen_ns > NEW_GRASP_NS:
            self._release(time_ns)
        self._seen_ns, self._gone = time_ns, False
        pattern = difference
        if self._slopes is not None:
            with one_blas_thread():
                pattern = self._slopes.of(difference, region.mask)

        @cache
        def texture(busy: bool) -> Texture:
            watch.lap("alignment")
            of = self._texture.of(fine, clean, light, region.mask, time_ns, self._tracker, busy)
            watch.lap("texture")
            return of

        seen = Seen(pattern, texture, region, torn, time_ns)
        tracked = self._tracker.follow(seen, self._report.angle_rad or 0.0)
        skipped = () if texture.cache_info().currsize else ("texture",)
        if skipped and not self._skip:
            texture(True)
        watch.lap("alignment")
        contact = self._tracker.contact
        sample = SlipSample(
            time_ns,
            State.UNOBSERVABLE if contact is None else State.LOST,
            contact_area_px=full_area(region.area_px, work.shape, image.shape),
            stage_s=watch.stage_s,
            skipped=skipped if self._skip else (),
            settled=contact is not None and contact.settled,
        )
        if tracked is None or not tracked.fit.fits:
            if contact is not None and self._report.gives_up(time_ns):
                self._release(time_ns)
            return sample
        if contact is not None and not contact.keyring.observable:
            return replace(sample, state=State.UNOBSERVABLE)
        answer = self._report.answer(sample, tracked, contact, region.mask)
        watch.lap("answer")
        return answer

    def _find_contact(self, difference: Field, fine: Image, light: Light, time_ns: int) -> Region | None:
        """Return the region of the contact; None without one, or if only marks of the gel show."""
        region = find_contact(difference)
        if self._is_fine_due:
            self._fine_lit.fill(self._marks.marked)
        verdict = self._marks.judge(
            lambda: self._fine_lit.difference_with_marks(fine, light), region, time_ns
        )
        self._is_fine_due = verdict.is_news
        if verdict.is_news:
            self._lit.fill(self._marks.marked)  # that of the fine copy in the next frame, to share the time
            self._texture.leave_out(self._marks.later)
        if verdict.was_mark:
            self._tracker.release()
            self._report.begin()
        return region if verdict.is_contact else None

    def _release(self, time_ns: int) -> None:
        """Forget the contact."""
        self._report.release(time_ns)
        self._tracker.release()
