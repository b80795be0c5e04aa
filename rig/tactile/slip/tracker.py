"""Track rotation and translation of the contact in one grasp, with as few keyframes as possible."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.evidence import Fit
from rig.tactile.slip.judge import Belief, by_texture, still_fits
from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.keys import MAX_JUMP_RAD, ContactPose, Key, PointMotion
from rig.tactile.slip.parameters import KEYFRAMES, SLOPES, TEXTURE
from rig.tactile.slip.registration import Alignment, align, angle_variance
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField, TextureKey

MAX_KEYFRAMES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The pose of a frame, the key that it was aligned to, and the quality of the fit.

    variance: of the angle, rad^2. base: the key whose variance is part of it. alignment: of the slopes. fit:
    fit of the key if the texture leads, else None. shape_doubt: additional variance of an arc or a round
    contact. pivot_rad: see `Key`. corrected_rad: change of the angle in this frame by the long axis of the
    contact.
    """

    pose: ContactPose
    key: Key
    variance: float
    base: Key
    alignment: Alignment | None = None
    fit: Fit | None = None
    shape_doubt: float = 0.0
    pivot_rad: float = 0.0
    corrected_rad: float = 0.0

    @property
    def inherited(self) -> float:
        """The part of the variance that was present when the key was taken."""
        return min(self.base.variance, self.variance)

    @property
    def misfit(self) -> float:
        """The misfit of the slopes, see `Alignment`."""
        return math.inf if self.alignment is None else self.alignment.misfit

    @property
    def noise_rad(self) -> float:
        """One standard deviation of the angle from frame to frame."""
        return TEXTURE.noise_rad if self.alignment is None else self.alignment.noise_rad

    @property
    def good(self) -> bool:
        """Whether the keyframe still fits well."""
        found = self.alignment
        if found is not None:
            worst = SLOPES.good_misfit if found.settled else SLOPES.unsettled_misfit
            return found.misfit <= worst and found.overlap >= SLOPES.good_overlap
        turned_rad = self.pose.angle_rad - self.key.pose.angle_rad
        return self.fit is not None and still_fits(self.fit, turned_rad)


class KeyframeTracker:
    """Follows one grasp from its first keyframe on.

    angle_rad, variance: of the pose at the first keyframe. aspect_known: see `angle_variance`.
    to_the_end: see `align`.
    """

    def __init__(
        self,
        first: Keyframe,
        texture: TextureKey | None,
        angle_rad: float,
        variance: float,
        aspect_known: bool = False,
        to_the_end: bool = False,
    ) -> None:
        self._aspect_known, self._to_the_end = aspect_known, to_the_end
        self._keys = [Key(first, texture, ContactPose(angle_rad, first.center_px), variance)]
        self._key = self._keys[0]
        self._pose = self._key.pose
        self._motion = PointMotion()
        self._weights: NDArray[np.float32] | None = None
        self.texture_leads = False

    def track(
        self, field: GradientField, texture: TextureField | None, expected_rad: float
    ) -> Tracked | None:
        """Return the pose in a frame, None where no keyframe fits.

        texture: None if it is not due. expected_rad: the initial angle.
        """
        expected = ContactPose(expected_rad, self._pose.point_px)
        found = self._by_slopes(field, expected)
        belief = None if texture is None else self._believed(field, texture, found, expected)
        if texture is not None:
            self.texture_leads = belief is not None
        if belief is not None:
            far = abs(belief.fit.pose.angle_rad - self._pose.angle_rad) > MAX_JUMP_RAD
            if belief.fit.score < TEXTURE.lost_score or far:
                return None
            key = self._keys[-1]
            found = Tracked(
                belief.pose,
                key,
                belief.variance,
                key,
                fit=belief.fit,
            )
        return None if found is None else self._accept(found)

    def _believed(
        self, field: GradientField, texture: TextureField, found: Tracked | None, expected: ContactPose
    ) -> Belief | None:
        """Return the pose by slopes and texture together; None if the pose of the slopes stands."""
        start = replace(expected, point_px=expected.point_px + self._motion.per_frame_px)
        if found is not None and not self.texture_leads:
            start = found.pose
        by_slopes = found.pose if found is not None and found.misfit <= SLOPES.plain_misfit else None
        return by_texture(self._keys, field, texture, start, by_slopes, self.texture_leads)

    def _by_slopes(self, field: GradientField, expected: ContactPose) -> Tracked | None:
        older = self._surest(expected.angle_rad)
        anchored = None if older is None else self._near(older, field, expected)
        if anchored is not None and anchored.good:
            return anchored
        found = self._near(self._key, field, expected)
        if found is None:
            return self._by_others(field, expected)
        return found if anchored is None else _fused(found, anchored)

    def add_key(self, key: Key) -> None:
        """Add a keyframe; beyond `MAX_KEYFRAMES` remove the oldest one except the first."""
        self._key = key
        self._keys.append(key)
        self._weights = None
        if len(self._keys) > MAX_KEYFRAMES:
            del self._keys[1]

    def _surest(self, angle_rad: float) -> Key | None:
        """Return the near key with the smallest variance, if it is smaller than that of the present key."""
        near = [k for k in self._keys if k.near(angle_rad)]
        surest = min(near, key=lambda k: k.variance, default=self._key)
        return surest if surest.variance < self._key.variance else None

    def _by_others(self, field: GradientField, expected: ContactPose) -> Tracked | None:
        """Align with another key that is near and fits well."""
        for key in self._keys:
            if key is not self._key and key.near(expected.angle_rad):
                found = self._near(key, field, expected)
                if found is not None and found.good:
                    return found
        return None

    def _near(self, key: Key, field: GradientField, expected: ContactPose) -> Tracked | None:
        """Align with a key; return None if it does not fit or the rotation is larger than `MAX_JUMP_RAD`."""
        found = self._aligned(key, field, expected)
        if found is None or abs(found.pose.angle_rad - expected.angle_rad) > MAX_JUMP_RAD:
            return None
        return found

    def _aligned(self, key: Key, field: GradientField, expected: ContactPose) -> Tracked | None:
        weights = self._weights if key is self._key else None
        angle, shift = key.motion_to(expected)
        alignment = align(key.frame, field, angle, shift, weights, self._to_the_end)
        fits = alignment.misfit <= SLOPES.worst_misfit and alignment.overlap >= SLOPES.worst_overlap
        if not fits:
            return None
        pose = key.pose_after(alignment.angle_rad, alignment.shift_px)
        own = angle_variance(alignment, key.frame.contrast, self._aspect_known)
        return Tracked(pose, key, key.variance + own, key, alignment)

    def _accept(self, found: Tracked) -> Tracked:
        self._motion.update(found.pose.point_px - self._pose.point_px)
        self._key, self._pose = found.key, found.pose
        self._weights = None if found.alignment is None else found.alignment.weights
        key = found.key  # for any key, the arc is that of the newest one
        by_pivot = max(key.frame.pivot, self._keys[-1].frame.pivot)
        turned = found.pose.angle_rad - key.pose.angle_rad
        return replace(found, pivot_rad=key.pivot_rad + by_pivot * turned)


def _fused(newer: Tracked, older: Tracked) -> Tracked:
    """Return the fused pose of two keys, weighted by their variances; if they contradict, that of the newer.

    The variance that both inherit from the older key is a common error.
    """
    common = older.key.variance
    one, two = max(newer.variance - common, 1e-12), max(older.variance - common, 1e-12)
    gap = older.pose.angle_rad - newer.pose.angle_rad
    if abs(gap) > KEYFRAMES.same_sigmas * math.sqrt(one + two):
        return newer
    share = one / (one + two)
    pose = replace(newer.pose, angle_rad=newer.pose.angle_rad + share * gap)
    return replace(newer, pose=pose, variance=common + one * two / (one + two), base=older.key)
