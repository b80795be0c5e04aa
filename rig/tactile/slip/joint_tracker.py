"""Follow a contact by aligning each frame to several keyframes at once.

Keyframe k was taken at angle theta_k with the tracked point at p_k. For a candidate pose (theta, p) it has
rotated by theta - theta_k, and its center has moved so that the point is at p. The residuals of its slopes
and of its texture, each divided by the residual energy of the channel, are linearised in (theta, p); gain and
constant slope of each keyframe are eliminated by the Schur complement of its normal matrix. The sum over the
keyframes, weighted by richness, and a Gaussian prior around the predicted angle give one 3 x 3 system per
iteration. Because the unknowns are common, the other keyframes outweigh one that follows the resting gel.
"""

import math
from functools import partial

from drivers.clock import NS_PER_S
from rig.tactile.slip.channel import JointKey
from rig.tactile.slip.evidence import Fit, aligned
from rig.tactile.slip.following import SeenContact, contact_box
from rig.tactile.slip.fused_angle import JointAngle
from rig.tactile.slip.gradient import Learn, learn_map
from rig.tactile.slip.joint_keys import RichKeyframes
from rig.tactile.slip.kalman import RateFilter
from rig.tactile.slip.keys import ContactPose, PointMotion
from rig.tactile.slip.parameters import JOINT, MOTION, TEXTURE
from rig.tactile.slip.sampling import GradientField

ITERATIONS = 16
# Further initial angles, in multiples of `aside_rad`.
ASIDE = -2.0, -1.0, 1.0, 2.0
# Largest rotation of an object between two frames (200 degrees per second at 10 Hz, with a margin).
MOST_TURN_RAD = math.radians(25.0)


class JointTracker:
    """Follows one contact after the other; each continues at the angle of the previous one.

    learn: returns the map of a keyframe.
    """

    def __init__(self, learn: Learn = learn_map) -> None:
        self._learn = learn
        self._pose = ContactPose(0.0, 0j)
        self._filter = RateFilter()
        self.release()

    def release(self) -> None:
        """Forget the keyframes, because the contact has ended."""
        self._keys = RichKeyframes(self._learn)
        self._wanted: tuple[SeenContact, ContactPose] | None = None
        self._motion, self._rate_rad_s = PointMotion(), 0.0
        self._filter.restart()

    def follow(self, seen: SeenContact) -> JointAngle | None:
        """Return the angle in a frame; None if the contact cannot be followed in it."""
        if self._keys.map is None:
            return self._begun(seen)
        self.take_keyframe()
        box, texture = contact_box(seen.region.mask), seen.texture()
        field = GradientField(self._keys.map.apply(seen.difference, box), seen.region.mask, box)
        found = self._found(self._keys.facing(field, texture), seen.time_ns / NS_PER_S)
        angle_rad = found.pose.angle_rad
        if abs(angle_rad - self._pose.angle_rad) > MOST_TURN_RAD:
            return None
        self._accept(found.pose, seen.time_ns / NS_PER_S)
        if not seen.torn and self._keys.wants(texture, seen.region.mask, angle_rad):
            self._wanted = seen, found.pose
        return self._filtered(found.score, found.own_rad, seen.time_ns)

    def take_keyframe(self) -> None:
        """Take the keyframe that the last frame needs. If this is not called, the next frame does it."""
        if self._wanted is not None:
            (seen, pose), self._wanted = self._wanted, None
            self._keys.add(seen.difference, seen.texture(), seen.region.mask, pose.angle_rad, pose.point_px)

    def _begun(self, seen: SeenContact) -> JointAngle | None:
        """Take the first keyframe."""
        if seen.torn:
            return None
        angle_rad, mask = self._pose.angle_rad, seen.region.mask
        point = self._keys.add(seen.difference, seen.texture(), mask, angle_rad, None)
        if point is None:
            return None
        self._pose = ContactPose(angle_rad, point)
        # The fit of a keyframe with itself has the highest possible score.
        return self._filtered(-math.log(JOINT.least_unexplained), 0.0, seen.time_ns)

    def _accept(self, pose: ContactPose, time_s: float) -> None:
        self._motion.update(pose.point_px - self._pose.point_px)
        elapsed_s = time_s - (self._filter.time_s or time_s)
        if elapsed_s > 0.0:
            rate = (pose.angle_rad - self._pose.angle_rad) / elapsed_s
            self._rate_rad_s += min(1.0, elapsed_s / MOTION.joint_rate_s) * (rate - self._rate_rad_s)
        self._pose = pose

    def _filtered(self, score: float, own_rad: float, time_ns: int) -> JointAngle:
        angle = self._filter.update(time_ns / NS_PER_S, self._pose.angle_rad, TEXTURE.noise_rad)
        return JointAngle(angle, self._filter.rate_rad_s, score, own_rad, self._keys.richest)

    def _found(self, keys: list[JointKey], time_s: float) -> Fit:
        """Return the best alignment over one or several initial poses."""
        angle, point = self._pose.angle_rad, self._pose.point_px
        ahead_s = min(time_s - (self._filter.time_s or time_s), MOTION.horizon_s)
        expected = angle + self._rate_rad_s * ahead_s
        align = partial(aligned, keys, iterations=ITERATIONS, expected_rad=expected, prior=JOINT.prior_weight)
        found = align(start=ContactPose(expected, point + self._motion.per_frame_px))
        surprise = abs(found.pose.angle_rad - expected)
        if found.score >= JOINT.good_score and surprise <= JOINT.surprise_rad:
            return found
        starts = (angle, *(expected + aside * JOINT.aside_rad for aside in ASIDE))
        others = (align(start=ContactPose(start, point)) for start in starts)
        return max(found, *others, key=lambda one: one.score)
