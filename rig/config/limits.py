"""What a bench file holds of limits: of the arm's motions, of the fingers' range."""

import math
from typing import Annotated

from pydantic import Field

from drivers.types import ArmLimits, GripperSpec, Vector6
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


Range = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]


class GripperLimitsConfig(BenchSection):
    """Range of the fingers, and of the speed and force that they may be commanded.

    A Robotiq's stroke and resolution follow from its counts: min_counts open, max_counts closed,
    opening_per_count_m. Any other gripper gives stroke_m and resolution_m instead.
    """

    later = frozenset({"stroke_m", "resolution_m", "speed_m_s", "force_n"})
    min_counts: int = Field(default=6, ge=0, le=255)
    max_counts: int = Field(default=255, ge=0, le=255)
    max_opening_m: float = Field(default=0.120, gt=0, le=0.155)
    opening_per_count_m: float = Field(default=0.155 / 249.0, gt=0, le=0.005)

    stroke_m: float | None = Field(default=None, gt=0, le=0.3)
    resolution_m: float | None = Field(default=None, ge=0.00005, le=0.005)
    speed_m_s: Range = (0.022, 0.110)
    force_n: Range = (15.0, 60.0)

    def spec(self, opening: tuple[tuple[float, float], ...] = ()) -> GripperSpec:
        """Return what the gripper can do. opening: measured pairs of counts and m."""
        step_m = self.resolution_m or self.opening_per_count_m
        return GripperSpec(
            self.max_opening_m,
            self.stroke_m or (self.max_counts - self.min_counts) * step_m,
            step_m,
            self.speed_m_s,
            self.force_n,
            tuple((counts - self.min_counts, opening_m) for counts, opening_m in opening),
        )


def _radians(angles_deg: JointAngles) -> Vector6:
    a, b, c, d, e, f = (math.radians(angle) for angle in angles_deg)
    return a, b, c, d, e, f
