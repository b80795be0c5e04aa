"""Follows a contact by aligning each frame to several keyframes at once.

Each keyframe k was taken at angle theta_k with the followed point at p_k. For a trial pose (theta, p) it has
turned by theta - theta_k, and its center has moved so that the point is at p. The residuals of its slopes and
of its texture, each divided by what the channel leaves unexplained, are linearised in (theta, p); gain and
constant slope of each keyframe are eliminated by the Schur complement of its normal matrix. The sum over the
keyframes, weighted by richness, and a Gaussian prior around the predicted angle give one 3 x 3 system per
iteration. Since the unknowns are common, a keyframe that follows the resting gel is outvoted.
"""

import math
from dataclasses import dataclass

import numpy as np

from drivers.clock import NS_PER_S
from rig.tactile.slip.channel import MOST_KEYS, JointKey
from rig.tactile.slip.evidence import TOGETHER, Motion
from rig.tactile.slip.following import SeenContact, contact_box
from rig.tactile.slip.joint_keys import RichKeyframes
from rig.tactile.slip.loops import align_jointly
from rig.tactile.slip.sampling import GradientField

# One standard deviation of the turn from the prediction, and the number of independent points of a contact,
# by which the prior is divided as the sums of squares are. Set on the augmented development clips: 12 points
# instead of 40 lose 4 % of the labels.
PRIOR_RAD, INDEPENDENT_POINTS = math.radians(4.0), 40.0
PRIOR = 1.0 / (INDEPENDENT_POINTS * PRIOR_RAD**2)
ITERATIONS = 16
# Further initial angles are tried if the score is lower, or the result is further from the prediction.
GOOD_SCORE, SURPRISE_RAD = 0.7, math.radians(2.0)
ASIDE_RAD = tuple(math.radians(turn) for turn in (-11.4, -5.7, 5.7, 11.4))
# An object turns at most so far between two frames (200 degrees per second at 10 Hz, with reserve).
MOST_TURN_RAD = math.radians(25.0)
# The rate follows the turn of a frame with this time constant, and predicts at most so far ahead.
RATE_S, HORIZON_S = 0.06, 0.1
# The first keyframe fits itself: the highest score that two channels can reach.
FIRST_SCORE = -math.log(0.1)
# The point's speed is followed up to so many work pixels per frame.
MOST_MOVING_PX = 3.0


@dataclass(frozen=True, slots=True)
class JointAnswer:
    """The angle of a contact, rad; its zero is the tracker's own.

    score: mean of the keyframes' `Motion.evidence`. own_rad: one standard deviation of the angle if the
    contact had one independent point.
    """

    angle_rad: float
    score: float
    own_rad: float


@dataclass(frozen=True, slots=True)
class _Found:
    """An alignment. point_px: where the followed point is. The rest as in `JointAnswer`."""

    angle_rad: float
    point_px: complex
    score: float
    own_rad: float


class JointTracker:
    """Follows one contact after the other; its angle goes on from one to the next."""

    def __init__(self) -> None:
        self._angle_rad = 0.0
        self.release()

    def release(self) -> None:
        """Forget the keyframes: the contact has ended."""
        self._keys = RichKeyframes()
        self._point_px, self._moving_px, self._rate_rad_s, self._time_ns = 0j, 0j, 0.0, 0

    def follow(self, seen: SeenContact) -> JointAnswer | None:
        """Return the angle in a frame; None if the contact cannot be followed in it."""
        if self._keys.map is None:
            return self._begun(seen)
        box, texture, elapsed_s = contact_box(seen.region.mask), seen.texture(), self._since_last(seen)
        field = GradientField(self._keys.map.apply(seen.difference, box), seen.region.mask, box)
        found = self._found(self._keys.facing(field, texture), elapsed_s)
        if abs(found.angle_rad - self._angle_rad) > MOST_TURN_RAD:
            return None
        self._accept(found, elapsed_s)
        if not seen.torn and self._keys.wants(texture, seen.region.mask, found.angle_rad):
            self._keys.add(seen.difference, texture, seen.region.mask, found.angle_rad, found.point_px)
        return JointAnswer(found.angle_rad, found.score, found.own_rad)

    def _begun(self, seen: SeenContact) -> JointAnswer | None:
        """Take the first keyframe."""
        if seen.torn:
            return None
        point = self._keys.add(seen.difference, seen.texture(), seen.region.mask, self._angle_rad, None)
        if point is None:
            return None
        self._point_px, self._time_ns = point, seen.time_ns
        return JointAnswer(self._angle_rad, FIRST_SCORE, 0.0)

    def _since_last(self, seen: SeenContact) -> float:
        """Return the time since the last frame that was followed, s."""
        elapsed_s = (seen.time_ns - self._time_ns) / NS_PER_S
        self._time_ns = seen.time_ns
        return elapsed_s

    def _found(self, keys: list[JointKey], elapsed_s: float) -> _Found:
        """Return the best alignment over one or several initial poses."""
        expected = self._angle_rad + self._rate_rad_s * min(elapsed_s, HORIZON_S)
        found = _aligned(keys, (expected, self._point_px + self._moving_px), expected)
        if found.score >= GOOD_SCORE and abs(found.angle_rad - expected) <= SURPRISE_RAD:
            return found
        starts = (self._angle_rad, *(expected + aside for aside in ASIDE_RAD))
        others = (_aligned(keys, (start, self._point_px), expected) for start in starts)
        return max(found, *others, key=lambda one: one.score)

    def _accept(self, found: _Found, elapsed_s: float) -> None:
        moved = found.point_px - self._point_px
        self._moving_px = 0.5 * (self._moving_px + moved * min(1.0, MOST_MOVING_PX / max(abs(moved), 1e-9)))
        if elapsed_s > 0.0:
            rate = (found.angle_rad - self._angle_rad) / elapsed_s
            self._rate_rad_s += min(1.0, elapsed_s / RATE_S) * (rate - self._rate_rad_s)
        self._angle_rad, self._point_px = found.angle_rad, found.point_px


def _aligned(keys: list[JointKey], start: tuple[float, complex], expected_rad: float) -> _Found:
    """Align a frame to keyframes, from an initial angle and point."""
    # The compiled loop takes a fixed number of keyframes; those of weight 0 do not count.
    filled = (*keys, *(MOST_KEYS - len(keys)) * (keys[0]._replace(weight=0.0),))
    shares = TOGETHER.slopes, TOGETHER.texture
    angle, point, normal, fits = align_jointly(filled, start, expected_rad, PRIOR, shares, ITERATIONS)
    scores = [Motion(angle, point, *fit).evidence for fit in fits[: len(keys)]]
    weights = [key.weight for key in keys]
    own_rad = math.sqrt(max(float(np.linalg.inv(normal)[0, 0]), 0.0))
    return _Found(angle, point, float(np.average(scores, weights=weights)), own_rad)
