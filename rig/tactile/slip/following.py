"""Follow the grasps of one sensor: select the keyframe to align to, and decide when to take another.

A keyframe gets the pose and the variance of its frame. If no keyframe fits, the angle is unknown until one
fits again; the uncertainty of the rotation in the meantime follows from the last rate.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.gate import Region
from rig.tactile.sample import State, Stopwatch
from rig.tactile.slip.axis_check import AxisAnchor, anchor
from rig.tactile.slip.gradient import Box, Learn, LearntGradientMap, learn_map
from rig.tactile.slip.height import Field, Gradient, only_within
from rig.tactile.slip.kalman import RateFilter, unseen_variance
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.keys import Key, weighted
from rig.tactile.slip.parameters import KEYFRAMES
from rig.tactile.slip.roundness import LEAST_TRACE, like_a_ball, missed_rad
from rig.tactile.slip.sampling import BROAD_REACH_PX, GradientField
from rig.tactile.slip.settling import Growth
from rig.tactile.slip.texture import TextureField, make_texture_key
from rig.tactile.slip.tracker import KeyframeTracker, Tracked

BOX_MARGIN_PX = BROAD_REACH_PX + 3
# Below this contrast a rotation does not change the image (smooth balls and rings reach 0.15, ovals with an
# axis ratio of 1.3 about 0.2), and the angle is refused. If the edge of the image clips a ball, the map
# learnt from the rest has an artificial direction (real balls then reach 0.6).
LEAST_CONTRAST, LEAST_CONTRAST_CLIPPED = 0.18, 0.7
# Frames until a refused contact is examined again.
PATIENCE_FRAMES = 12
# Number of frames without a fitting keyframe after which a growing contact gets a new one.
DEFERRED_FRAMES = 2
# Answers from the keyframe of a settled contact on until the filtered angle is that of the keyframe. At the
# keyframe it was up to 0.6 degrees away, two frames later 0.05 (SIMULATED, 200 presses).
FILTERED_FRAMES = 2
# Period of the texture while the slopes lead.
TEXTURE_PERIOD_S = 0.035
TEXTURE_STAGE = "texture"


class TextureOnDemand:
    """The texture of a frame, computed when it is first needed."""

    def __init__(self, compute: Callable[[], TextureField]) -> None:
        self._compute = compute
        self.computed: TextureField | None = None

    def __call__(self) -> TextureField:
        """Return the texture."""
        if self.computed is None:
            self.computed = self._compute()
        return self.computed


@dataclass(frozen=True, slots=True, eq=False)
class SeenContact:
    """A frame with a contact.

    difference: (h, w, 3), relative, or slopes of `CalibratedSlopes`. torn: no keyframe should be taken of it.
    """

    difference: Field
    texture: TextureOnDemand
    region: Region
    torn: bool
    time_ns: int


class ContactFollower:
    """Follows the contacts of one sensor.

    motion: the filter that predicts the angle; it is restarted with a keyframe that was not tracked.
    aspect_known: see `angle_variance`. skip: see `SlipEstimator`. learn: returns the map of a new contact.
    point_px, origin_px: present and first position of the grasp's first keyframe, work pixels.
    """

    def __init__(self, motion: RateFilter, aspect_known: bool, skip: bool, learn: Learn = learn_map) -> None:
        self._motion, self._aspect_known, self._skip, self._learn = motion, aspect_known, skip, learn
        self._angle_rad, self._variance, self._unseen = 0.0, 0.0, 0.0
        self._fitted_ns, self._key_ns = 0, 0
        self._texture_ns: int | None = None
        self._answered = self._firmer = self._due = False
        self._anchor: AxisAnchor | None = None
        self.release(0)

    def answered(self, angle_rad: float, variance: float, tracked: Tracked) -> None:
        """Store the reported angle of a frame, at which the next grasp begins."""
        self._angle_rad, self._variance, self._answered = angle_rad, variance, True
        self._followed += self._growth.settled and not self._due
        self.point_px = tracked.pose.point_px

    @property
    def settled(self) -> bool:
        """Whether the contact has settled, with a keyframe to whose angle the filter has converged."""
        return self._followed >= FILTERED_FRAMES

    def gripped_further(self) -> None:
        """Take a keyframe of the next frame, because the fingers have closed further."""
        self._firmer = True

    def follow(self, seen: SeenContact, watch: Stopwatch) -> tuple[State, Tracked | None]:
        """Return the state and the pose; None if the pose is unknown."""
        settled = self._growth.update(seen.region.levels, seen.time_ns)
        # An angle that the axis may still correct waits for a frame that fits.
        self._due = settled or (self._due and self._anchor is not None)
        if self._grasp is None or self._map is None:
            return self._begun(seen, watch)
        box = contact_box(seen.region.mask)
        gradient = self._map.apply(seen.difference, box if self._skip else None)
        if not self._skip:  # outside the box there is no contact
            gradient = only_within(gradient, box)
        watch.lap("gradient")
        texture = self._texture(seen, self._grasp)
        watch.lap(TEXTURE_STAGE)
        field = GradientField(gradient, seen.region.mask, box)
        tracked = self._aligned(self._grasp, field, texture, seen.time_ns)
        watch.lap("alignment")
        if tracked is None:
            return self._missed(seen, watch)
        tracked = replace(tracked, shape_doubt=self._shape_doubt(tracked, seen.time_ns))
        self._fitted_ns, self._misses = seen.time_ns, 0
        renewed = None if seen.torn else self._renewed(seen, gradient, tracked)
        watch.lap("keyframe")
        return (State.TRACKING, tracked) if renewed is None else (State.REKEYED, renewed)

    def _shape_doubt(self, tracked: Tracked, time_ns: int) -> float:
        """Return the variance due to the shape of the contact, rad^2: an arc, or a round contact."""
        by_pivot = max(0.0, tracked.pivot_rad**2 - tracked.base.pivot_rad**2)
        # A rotation that the image does not show is limited by the time since the keyframe.
        possible = unseen_variance(0.0, (time_ns - self._key_ns) / NS_PER_S)
        missed = min(missed_rad(tracked.key.frame.trace) ** 2, possible)
        # The inherited variance of the key contains that of its shape until then.
        return by_pivot + max(0.0, missed - tracked.inherited)

    def _texture(self, seen: SeenContact, grasp: KeyframeTracker) -> TextureField | None:
        """Return the texture of a frame if it is due: always while it leads, else periodically.

        A torn frame contains parts of two images, so it does not decide whether the texture leads.
        """
        last_ns = self._texture_ns
        due = last_ns is None or (seen.time_ns - last_ns) / NS_PER_S >= TEXTURE_PERIOD_S
        if not grasp.texture_leads and (seen.torn or not due):
            return None
        self._texture_ns = seen.time_ns
        return seen.texture()

    def _aligned(
        self, grasp: KeyframeTracker, field: GradientField, texture: TextureField | None, time_ns: int
    ) -> Tracked | None:
        """Return the pose of the contact; None if no keyframe fits."""
        expected = self._motion.predicted(time_ns / NS_PER_S)
        return grasp.track(field, texture, expected)

    def _renewed(self, seen: SeenContact, gradient: Gradient, tracked: Tracked) -> Tracked | None:
        """Take a keyframe of this frame, with its pose and variance, if one is needed; else return None."""
        firmer, self._firmer = self._firmer, False
        settled = self._due or firmer
        if firmer:
            self._anchor = None
        outgrown = (not tracked.good or tracked.fit is not None) and self._growth.outgrown(seen.region)
        if tracked.good and not settled and not outgrown:
            return None
        variance = max(tracked.variance, self._variance)
        angle, variance = self._by_axis(seen.region.mask, tracked.pose.angle_rad, variance)
        pose = replace(tracked.pose, angle_rad=angle)
        corrected = angle - tracked.pose.angle_rad
        if self._due and corrected:  # for the rotation without contact, which is not seen as motion
            self._motion.restart()
        placed = replace(tracked, pose=pose, variance=variance, corrected_rad=corrected)
        if settled or outgrown:
            return placed if self._begin(seen, angle, variance, firmer) else None
        frame = make_keyframe(gradient, seen.region.mask)
        if self._grasp is None or frame is None or not _observable(frame):
            return None
        self._key_ns = seen.time_ns
        texture = make_texture_key(seen.texture(), seen.region.mask, frame.center_px)
        self._grasp.add_key(
            Key(weighted(frame, texture), texture, placed.pose, placed.variance, placed.pivot_rad)
        )
        return placed

    def _missed(self, seen: SeenContact, watch: Stopwatch) -> tuple[State, Tracked | None]:
        """Wait if no keyframe fits; restart after `give_up_s`."""
        self._misses += 1
        elapsed_s = (seen.time_ns - self._fitted_ns) / NS_PER_S
        waits, deferred = elapsed_s <= KEYFRAMES.give_up_s, self._misses <= DEFERRED_FRAMES
        patient = waits if self._growth.settled else deferred
        if patient or seen.torn:
            return State.LOST, None
        angle = self._motion.predicted(seen.time_ns / NS_PER_S)
        variance = self._variance + unseen_variance(self._motion.rate_rad_s, elapsed_s)
        return self._restarted(seen, *self._by_axis(seen.region.mask, angle, variance), watch)

    def _begun(self, seen: SeenContact, watch: Stopwatch) -> tuple[State, Tracked | None]:
        """Take the first keyframe of a contact; try again later if its rotation is not observable."""
        self._patience -= 1
        if seen.torn or (self._patience >= 0 and not self._due):
            return State.UNOBSERVABLE, None
        angle, variance = self._by_axis(seen.region.mask, self._angle_rad, self._unseen)
        return self._restarted(seen, angle, variance, watch)

    def _restarted(
        self, seen: SeenContact, angle_rad: float, variance: float, watch: Stopwatch
    ) -> tuple[State, Tracked | None]:
        """Take a keyframe of this frame at an angle that was not measured in it."""
        again = self._answered
        begun = self._begin(seen, angle_rad, variance)
        watch.lap("keyframe")
        if not begun or self._grasp is None or self._map is None:
            return State.UNOBSERVABLE, None
        field = GradientField(self._map.apply(seen.difference), seen.region.mask)
        self._fitted_ns, self._misses = seen.time_ns, 0
        self._motion.restart()
        tracked = self._grasp.track(field, None, angle_rad)
        return (State.REKEYED if again else State.TRACKING) if tracked else State.LOST, tracked

    def _by_axis(self, mask: Image, angle_rad: float, variance: float) -> tuple[float, float]:
        """Correct an angle that is less certain than the long axis of a settled contact."""
        if self._anchor is None or not self._growth.settled:
            return angle_rad, variance
        return self._anchor.corrected(mask, angle_rad, variance)

    def _begin(self, seen: SeenContact, angle_rad: float, variance: float, known: bool = False) -> bool:
        """Learn the map and take a keyframe of this frame; return False if its rotation is not observable.

        A contact that is already followed keeps its keyframe in that case.
        """
        self._patience, self._due = PATIENCE_FRAMES, False
        mask = seen.region.mask
        learnt = self._learn(seen.difference, mask)
        gradient = None if learnt is None else learnt.apply(seen.difference)
        frame = None if gradient is None else make_keyframe(gradient, mask)
        if frame is None or gradient is None or (self._grasp is None and _like_a_ball(frame, gradient, mask)):
            return False
        if not (_observable(frame) or (known and frame.contrast >= LEAST_CONTRAST)):
            return False
        moved = self.point_px - self.origin_px if self._grasp is not None else 0j
        self._key_ns = seen.time_ns
        self._growth.renewed(seen.region)
        if self._growth.settled and self._anchor is None:
            self._anchor = anchor(mask, angle_rad)
        self._map = learnt
        texture = make_texture_key(seen.texture(), mask, frame.center_px)
        frame = weighted(frame, texture)
        self._grasp = KeyframeTracker(frame, texture, angle_rad, variance, self._aspect_known, not self._skip)
        self.point_px, self.origin_px = frame.center_px, frame.center_px - moved
        return True

    def release(self, time_ns: int) -> None:
        """End a grasp. The next contact starts at the last angle of this one."""
        if self._answered:
            elapsed_s = (time_ns - self._fitted_ns) / NS_PER_S
            self._unseen = self._variance + unseen_variance(self._motion.rate_rad_s, elapsed_s)
        self._grasp: KeyframeTracker | None = None
        self._map: LearntGradientMap | None = None
        self._growth, self._due = Growth(), False
        self._patience, self._misses, self._followed = 0, 0, 0
        self.point_px = self.origin_px = 0j
        self._motion.restart()


def contact_box(mask: Image) -> Box:
    """Return the box around a mask with room for sharpening, interpolation and slopes at its edge."""
    left, top, width, height = cv2.boundingRect(mask)
    right, bottom = left + width + BOX_MARGIN_PX, top + height + BOX_MARGIN_PX
    left, top = max(left - BOX_MARGIN_PX, 0), max(top - BOX_MARGIN_PX, 0)
    return left, top, min(right, mask.shape[1]) - left, min(bottom, mask.shape[0]) - top


def _like_a_ball(frame: Keyframe, gradient: Gradient, mask: Image) -> bool:
    return like_a_ball(frame.points_px, frame.template, gradient, mask, frame.contrast)


def _observable(frame: Keyframe) -> bool:
    if frame.trace < LEAST_TRACE:
        return False
    return frame.contrast >= (LEAST_CONTRAST_CLIPPED if frame.clipped else LEAST_CONTRAST)
