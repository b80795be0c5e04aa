"""What a motion of the arm may ask for: checked before anything is sent."""

import math
from collections.abc import Sequence

from scipy.spatial.transform import Rotation

from drivers.errors import OutOfLimitsError
from drivers.types import ArmLimits, Pose, Vector6

_FULL_TURN = 2 * math.pi
JOINT_RANGE_RAD: tuple[Vector6, Vector6] = (
    (-_FULL_TURN, -_FULL_TURN, -_FULL_TURN, -_FULL_TURN, -_FULL_TURN, -_FULL_TURN),
    (_FULL_TURN, _FULL_TURN, _FULL_TURN, _FULL_TURN, _FULL_TURN, _FULL_TURN),
)
"""Working range of a UR5e's joints: +-360 degrees (data sheet)."""


def check_motion(limits: ArmLimits, target: Pose, speed_m_s: float, acceleration_m_s2: float) -> None:
    """Raise `OutOfLimitsError` for a target, speed or acceleration outside the limits, or not a number."""
    if not limits.has_inside(target.position_m):
        low, high = limits.workspace_min_m, limits.workspace_max_m
        raise OutOfLimitsError(f"arm: target {target.position_m} m leaves the workspace {low} to {high} m")
    if not all(map(math.isfinite, target.quaternion_xyzw)):
        raise OutOfLimitsError(f"arm: target {target} is no pose")
    for what, value, most, unit in (
        ("speed", speed_m_s, limits.max_speed_m_s, "m/s"),
        ("acceleration", acceleration_m_s2, limits.max_acceleration_m_s2, "m/s2"),
    ):
        if not 0.0 < value <= most:
            raise OutOfLimitsError(f"arm: {what} {value} {unit} is outside 0 to {most} {unit}")


def check_joints(joints: Sequence[float] | None, limits: tuple[Vector6, Vector6], target: Pose) -> None:
    """Raise `OutOfLimitsError` where no joints reach the target, or one of them leaves its range."""
    if not joints:
        raise OutOfLimitsError(f"arm: pose {target} is out of reach or outside the safety limits")
    for number, (angle, low, high) in enumerate(zip(joints, *limits, strict=True), 1):
        if not low <= angle <= high:
            raise OutOfLimitsError(
                f"arm: joint {number} would go to {math.degrees(angle):.1f} deg, outside "
                f"{math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
            )


def to_ur(pose: Pose) -> Vector6:
    """The controller's notation of a pose: x y z in m, rotation vector in rad."""
    x, y, z = pose.position_m
    rx, ry, rz = (float(v) for v in pose.rotation.as_rotvec())
    return x, y, z, rx, ry, rz


def from_ur(values: Vector6) -> Pose:
    """The pose that the controller's notation stands for."""
    return Pose.from_rotation((values[0], values[1], values[2]), Rotation.from_rotvec(values[3:]))
