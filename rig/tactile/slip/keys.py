"""A grasp's keyframes and the poses of its contact."""

import math
from dataclasses import dataclass

from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.loops import turning
from rig.tactile.slip.texture import TextureKey

# From where it is expected, an object turns at most so far between two frames.
MAX_JUMP_RAD = math.radians(20.0)
# A keyframe says something of a contact within this of its own angle.
NEAR_RAD = math.radians(25.0)
# Two keyframes that tell angles further apart than this many standard deviations do not see the same.
SAME_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ContactPose:
    """Where a contact is.

    angle_rad: from the grasp's zero. point_px: where the first keyframe's center is now, x + i y.
    """

    angle_rad: float
    point_px: complex


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """A keyframe, the pose at which it was taken, and the variance of that angle, rad^2.

    texture: None where there is too little of it. pivot_rad: what an unknown pivot has left open of the angle
    until then, a part of its standard deviation; it grows with the turn and shrinks on the way back.
    """

    frame: Keyframe
    texture: TextureKey | None
    pose: ContactPose
    variance: float
    pivot_rad: float = 0.0

    def near(self, angle_rad: float) -> bool:
        """Whether a contact at an angle may still look like this key."""
        return abs(angle_rad - self.pose.angle_rad) < NEAR_RAD

    def motion_to(self, pose: ContactPose) -> tuple[float, complex]:
        """Return the angle and the shift of this key's center that would put it at a pose."""
        turn = pose.angle_rad - self.pose.angle_rad
        return turn, pose.point_px - turning(turn) * self._lever_px - self.frame.center_px

    def pose_after(self, angle_rad: float, shift_px: complex) -> ContactPose:
        """Return the contact's pose after this key has turned and its center has moved."""
        point = self.frame.center_px + shift_px + turning(angle_rad) * self._lever_px
        return ContactPose(self.pose.angle_rad + angle_rad, point)

    @property
    def _lever_px(self) -> complex:
        return self.pose.point_px - self.frame.center_px
