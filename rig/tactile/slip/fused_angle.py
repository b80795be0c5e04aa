"""Fuse the angles of two trackers: `following` (one keyframe at a time) and `joint_tracker` (several).

The error of each tracker changes slowly. If the slopes explain a frame, they are those of the object, and the
error of the first tracker is a few hundredths of a degree. If they do not, a bulge of gel is at rest, and the
joint tracker is more often correct. Therefore the angle is a mixture

    angle = (1 - w) first + w (joint + offset),

whose weight w follows the leading channel with a time constant. While the slopes lead, the offset converges
to the difference of both, so that an error of the joint tracker during growth does not persist. The prior of
the motion is uniform within `MOST_RATE_RAD_S`, so the angle does not jump. While the slopes lead, the
variance is that of the first tracker. Otherwise it is a linear combination of known terms, one of which is
the squared gap between the trackers.
"""

import math
from dataclasses import dataclass

from rig.tactile.slip.parameters import FUSION

# Highest rotation rate of an object in a gripper.
MOST_RATE_RAD_S = math.radians(200.0)


@dataclass(frozen=True, slots=True)
class FirstAnswer:
    """The first tracker's filtered angle (rad) and rate (rad/s), its sigma, and whether the texture leads.

    Parts of the variance, rad^2: inherited from its keyframe; shape_doubt: due to the shape of the contact,
    for both trackers. corrected_rad: see `Tracked`; neither tracker observes a rotation without contact.
    """

    angle_rad: float
    rate_rad_s: float
    sigma_rad: float
    inherited: float
    shape_doubt: float
    texture_leads: bool
    corrected_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class JointAngle:
    """The joint tracker's filtered angle (rad) and rate (rad/s).

    score, own_rad: see `Fit`. richness: root energy of the texture of the richest keyframe.
    """

    angle_rad: float
    rate_rad_s: float
    score: float
    own_rad: float
    richness: float


@dataclass(frozen=True, slots=True)
class Fused:
    """The fused angle (rad) and rate (rad/s), and its variance, rad^2.

    inherited: the part of the variance from before the keyframes, such as that of rotations without contact.
    """

    angle_rad: float
    rate_rad_s: float
    variance: float
    inherited: float


class FusedAngle:
    """Fuses the two trackers of one sensor, frame by frame."""

    def __init__(self) -> None:
        self._angle_rad: float | None = None
        self._time_s = self._weight = self._first_zero = self._joint_zero = 0.0
        self.released()

    def released(self) -> None:
        """Forget the angles of the trackers, because the contact has ended.

        Neither tracker has observed the variance that the first keyframe of the next contact inherits.
        """
        self._first_rad: float | None = None
        self._joint_rad: float | None = None
        self._joint: JointAngle | None = None
        self._unseen = math.inf

    def update(self, time_s: float, first: FirstAnswer | None, joint: JointAngle | None) -> Fused | None:
        """Return the fused angle of a frame; None if neither tracker has one.

        joint: None also if it was not run. It is then assumed to rotate as the first tracker does.
        """
        if first is None and (joint is None or joint.score < FUSION.least_score):
            return None
        elapsed_s = 0.0 if self._angle_rad is None else time_s - self._time_s
        self._time_s = time_s
        at_first, at_joint = self._angles(first, joint)
        if first is None or at_first is None:
            weight, gap = 1.0, FUSION.unknown_gap_rad
        elif at_joint is None:
            weight, gap = 0.0, 0.0
        else:
            weight = self._weigh(first.texture_leads, elapsed_s)
            if not first.texture_leads:
                at_joint = self._drawn(at_joint, at_first, elapsed_s)
            gap = at_first - at_joint
        self._first_rad, self._joint_rad = at_first, at_joint
        wanted = (1.0 - weight) * (at_first or 0.0) + weight * (at_joint or 0.0)
        corrected = first is not None and first.corrected_rad != 0.0
        angle = self._bound(wanted, math.inf if corrected else elapsed_s)
        if first is not None:
            self._unseen = min(self._unseen, first.inherited)
        variance = weight * self._texture_variance(gap, first) + (wanted - angle) ** 2
        unseen = weight * self._unseen if math.isfinite(self._unseen) else 0.0
        if first is not None:
            variance += (1.0 - weight) * first.sigma_rad**2 + weight * first.shape_doubt
            inherited = unseen + (1.0 - weight) * first.inherited
        else:
            inherited = unseen
        return Fused(angle, self._rate(weight, first), variance + unseen, inherited)

    def take_late(self, joint: JointAngle, first_rad: float) -> None:
        """Use the joint tracker's angle in an earlier frame. first_rad: that of the first tracker there."""
        at_first = first_rad + self._first_zero
        if self._joint is None:
            self._joint_zero = at_first - joint.angle_rad
        turned = 0.0 if self._first_rad is None else self._first_rad - at_first
        self._joint, self._joint_rad = joint, joint.angle_rad + self._joint_zero + turned

    def _angles(
        self, first: FirstAnswer | None, joint: JointAngle | None
    ) -> tuple[float | None, float | None]:
        """Return both trackers' angles from the common zero, None if unknown."""
        at_first = None if first is None else first.angle_rad + self._first_zero
        if first is not None and self._unseen > first.inherited:
            self._joint_zero += first.corrected_rad
        turned = 0.0 if at_first is None or self._first_rad is None else at_first - self._first_rad
        at_joint = None if self._joint_rad is None else self._joint_rad + turned
        if joint is not None:
            if self._joint is None:  # it begins at the angle of the first tracker, or at the last fused angle
                begins = (self._angle_rad or 0.0) if at_first is None else at_first
                self._joint_zero = begins - joint.angle_rad
            self._joint, at_joint = joint, joint.angle_rad + self._joint_zero
        if at_first is not None and self._first_rad is None and at_joint is not None:
            # The first tracker begins again at the angle of the joint tracker.
            self._first_zero += at_joint - at_first
            at_first = at_joint
        return at_first, at_joint

    def _weigh(self, texture_leads: bool, elapsed_s: float) -> float:
        """Update the weight of the joint tracker and return it."""
        believed = texture_leads and self._joint is not None and self._joint.score > FUSION.least_score
        self._weight += (1.0 - math.exp(-elapsed_s / FUSION.weight_s)) * (float(believed) - self._weight)
        return self._weight

    def _drawn(self, at_joint: float, at_first: float, elapsed_s: float) -> float:
        """Update the offset of the joint tracker from the first one; return its angle with the new offset."""
        drawn = (1.0 - math.exp(-elapsed_s / FUSION.offset_s)) * (at_first - at_joint)
        self._joint_zero += drawn
        return at_joint + drawn

    def _bound(self, wanted_rad: float, elapsed_s: float) -> float:
        """Limit the angle to the prior of the motion. elapsed_s: infinite for a correction, no motion."""
        last, most = self._angle_rad, MOST_RATE_RAD_S * elapsed_s
        self._angle_rad = wanted_rad if last is None else min(max(wanted_rad, last - most), last + most)
        return self._angle_rad

    def _rate(self, weight: float, first: FirstAnswer | None) -> float:
        first_rate = 0.0 if first is None else first.rate_rad_s
        joint_rate = 0.0 if self._joint is None else self._joint.rate_rad_s
        return (1.0 - weight) * first_rate + weight * joint_rate

    def _texture_variance(self, gap_rad: float, first: FirstAnswer | None) -> float:
        """Return the variance while the texture leads, rad^2."""
        sigma = FUSION.unknown_sigma_rad if first is None else first.sigma_rad
        own, faint = 0.0, 1.0
        if self._joint is not None:
            faint = 1.0 / max(self._joint.richness, FUSION.least_richness)
            own = min(self._joint.own_rad, FUSION.most_own_rad)
            own /= max(self._joint.score, FUSION.least_own_score)
        parts = FUSION.gap * gap_rad, FUSION.sigma * sigma, FUSION.own_sigma * own
        return sum(part**2 for part in (FUSION.constant_rad, *parts, FUSION.faint_rad * faint))
