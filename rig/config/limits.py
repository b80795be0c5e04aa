"""What a bench file holds of limits: of the arm's motions, of the fingers' range."""

import math

from pydantic import Field

from drivers.types import ArmLimits, GripperLimits, Vector6
from rig.config.fields import BenchSection, JointAngles, Point


class ArmLimitsConfig(BenchSection):
    """Limits of the arm, checked before a command is sent. The defaults are the simulated cell's."""

    later = frozenset({"max_contact_force_n"})
    workspace_min_m: Point = (0.15, -0.35, 0.01)
    workspace_max_m: Point = (0.75, 0.35, 0.60)
    max_speed_m_s: float = Field(default=0.5, gt=0, le=1.0)
    max_acceleration_m_s2: float = Field(default=1.5, gt=0, le=2.5)
    max_payload_kg: float = Field(default=5.0, gt=0, le=5.0)
    max_contact_force_n: float = Field(default=20.0, ge=5, le=100)
    joint_min_deg: JointAngles = (-360.0, -360.0, -360.0, -360.0, -360.0, -360.0)
    joint_max_deg: JointAngles = (360.0, 360.0, 360.0, 360.0, 360.0, 360.0)

    def arm_limits(self) -> ArmLimits:
        """Return the limits as the arm takes them."""
        return ArmLimits(
            self.workspace_min_m,
            self.workspace_max_m,
            self.max_speed_m_s,
            self.max_acceleration_m_s2,
            self.max_payload_kg,
            self.max_contact_force_n,
        )

    def joint_limits_rad(self) -> tuple[Vector6, Vector6]:
        """Return lowest and highest joint angles, rad."""
        return _radians(self.joint_min_deg), _radians(self.joint_max_deg)


class GripperLimitsConfig(BenchSection):
    """Range of the fingers in counts, and the opening between the fingertips that counts stand for."""

    min_counts: int = Field(default=6, ge=0, le=255)
    max_counts: int = Field(default=255, ge=0, le=255)
    max_opening_m: float = Field(default=0.120, gt=0, le=0.155)
    opening_per_count_m: float = Field(default=0.155 / 249.0, gt=0, le=0.005)

    def gripper_limits(self) -> GripperLimits:
        """Return the limits as the gripper takes them."""
        return GripperLimits(self.min_counts, self.max_counts, self.max_opening_m, self.opening_per_count_m)


def _radians(angles_deg: JointAngles) -> Vector6:
    a, b, c, d, e, f = (math.radians(angle) for angle in angles_deg)
    return a, b, c, d, e, f
