"""The keyframes of a grasp and the poses of its contact."""

import math
from dataclasses import dataclass

from rig.tactile.slip.channel import JointKey, some_of
from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.loops import turning, turning_weights_of, weights_of
from rig.tactile.slip.parameters import KEYFRAMES, MOTION, TEXTURE
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField, TextureKey

# Largest turn of an object from its prediction between two frames.
MAX_JUMP_RAD = math.radians(20.0)
# Number of points of a keyframe's slopes if its texture is used, too.
SLOPE_POINTS = 300


class PointMotion:
    """The speed of a contact's point, work pixels per frame."""

    def __init__(self) -> None:
        self.per_frame_px = 0j

    def update(self, moved_px: complex) -> None:
        """Update with the motion of the point in one frame."""
        bounded = moved_px * min(1.0, MOTION.most_shift_px / max(abs(moved_px), 1e-9))
        self.per_frame_px = 0.5 * (self.per_frame_px + bounded)


@dataclass(frozen=True, slots=True, eq=False)
class ContactPose:
    """The pose of a contact.

    angle_rad: relative to the zero of the grasp. point_px: present position of the first keyframe's center, x
    + i y.
    """

    angle_rad: float
    point_px: complex


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """A keyframe, the pose at which it was taken, and the variance of that angle, rad^2.

    texture: None if there is too little of it. pivot_rad: part of the angle's standard deviation that is due
    to an unknown pivot; it grows with the rotation and shrinks when the contact rotates back.
    """

    frame: Keyframe
    texture: TextureKey | None
    pose: ContactPose
    variance: float
    pivot_rad: float = 0.0

    def facing(
        self, field: GradientField, texture: TextureField, weight: float = 1.0, fine: bool = False
    ) -> JointKey | None:
        """Return this key with a frame to align; None without texture.

        weight: relative to other keys. fine: see `Keyframe.fine_within`.
        """
        if self.texture is None:
            return None
        step = -(-len(self.frame.points_px) // SLOPE_POINTS)
        slopes = some_of(self.frame.fine_within(field) if fine else self.frame.within(field), step)
        lines = self.texture.within(texture, self.frame.center_px)
        shares = TEXTURE.rest_share, TEXTURE.noise_share
        rotating = self.texture.turning_at(slopes.points + slopes.center)
        slope_weights = turning_weights_of(slopes, rotating, *shares)
        both = slopes, slope_weights, lines, weights_of(lines, *shares)
        return JointKey(*both, weight, self.pose.angle_rad, complex(self._lever_px))

    def near(self, angle_rad: float) -> bool:
        """Whether a contact at this angle is near enough to be aligned with this key."""
        return abs(angle_rad - self.pose.angle_rad) < KEYFRAMES.near_rad

    def motion_to(self, pose: ContactPose) -> tuple[float, complex]:
        """Return the rotation and the shift of this key's center that bring it to a pose."""
        turn = pose.angle_rad - self.pose.angle_rad
        return turn, pose.point_px - turning(turn) * self._lever_px - self.frame.center_px

    def pose_after(self, angle_rad: float, shift_px: complex) -> ContactPose:
        """Return the pose of the contact after a rotation of this key and a shift of its center."""
        point = self.frame.center_px + shift_px + turning(angle_rad) * self._lever_px
        return ContactPose(self.pose.angle_rad + angle_rad, point)

    @property
    def _lever_px(self) -> complex:
        return self.pose.point_px - self.frame.center_px


def weighted(frame: Keyframe, texture: TextureKey | None) -> Keyframe:
    """Return a keyframe whose points have little weight where the texture rests with the gel."""
    return frame if texture is None else frame.weighted(texture.turning_at(frame.points_px + frame.center_px))
