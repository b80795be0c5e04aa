"""Where the simulated actuators are: timed paths of the tool and of the fingers."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from drivers.types import Pose
from fakes.world.trapezoid import TrapezoidProfile


@dataclass(frozen=True, slots=True)
class ToolPath:
    """A straight, timed motion of the tool centre point."""

    start: Pose
    end: Pose
    profile: TrapezoidProfile
    _tilts_rad: tuple[float, float]

    @classmethod
    def between(cls, start: Pose, end: Pose, profile: TrapezoidProfile) -> "ToolPath":
        """A motion from one pose to another."""
        return cls(start, end, profile, (tool_tilt(start), tool_tilt(end)))

    @classmethod
    def resting(cls, pose: Pose) -> "ToolPath":
        """A path that stays where it is."""
        return cls.between(pose, pose, TrapezoidProfile(0, 0.0, 1.0, 1.0))

    def position_at(self, time_ns: int) -> tuple[float, float, float]:
        """Position in base, m."""
        f = self.profile.fraction_at(time_ns)
        (x0, y0, z0), (x1, y1, z1) = self.start.position_m, self.end.position_m
        return x0 + f * (x1 - x0), y0 + f * (y1 - y0), z0 + f * (z1 - z0)

    def pose_at(self, time_ns: int) -> Pose:
        """`base_T_tcp`, orientation interpolated on the great circle."""
        f = self.profile.fraction_at(time_ns)
        if f >= 1.0 or self.start.quaternion_xyzw == self.end.quaternion_xyzw:
            return Pose(self.position_at(time_ns), self.end.quaternion_xyzw)
        turn = Slerp([0.0, 1.0], Rotation.concatenate([self.start.rotation, self.end.rotation]))
        return Pose.from_rotation(self.position_at(time_ns), turn(f))

    def tilt_at(self, time_ns: int) -> float:
        """The tool's turn about the base's -y axis, rad: counter-clockwise as the camera sees it."""
        f = self.profile.fraction_at(time_ns)
        start, end = self._tilts_rad
        return start + f * (end - start)

    def braked_at(self, time_ns: int, deceleration_m_s2: float) -> "ToolPath":
        """The same path with the tool braking from `time_ns` on."""
        return replace(self, profile=self.profile.braked_at(time_ns, deceleration_m_s2))


@dataclass(frozen=True, slots=True)
class FingerPath:
    """A timed motion of the grasping fingers, in counts."""

    start: float
    end: float
    profile: TrapezoidProfile

    def position_at(self, time_ns: int) -> float:
        """Finger position in counts."""
        return self.start + self.profile.fraction_at(time_ns) * (self.end - self.start)

    def cut_at(self, time_ns: int) -> "FingerPath":
        """The same path stopped at `time_ns`."""
        return replace(self, profile=replace(self.profile, stop_fraction=self.profile.fraction_at(time_ns)))


def tool_tilt(base_T_tcp: Pose) -> float:  # noqa: N803
    """Turn of a downward tool about the base's -y axis, rad, from its x axis."""
    x_axis = base_T_tcp.rotation.apply([1.0, 0.0, 0.0])
    return math.atan2(float(x_axis[2]), float(x_axis[0]))


def distance(start: Pose, end: Pose) -> float:
    """Length of a straight motion, m; a pure turn counts 0.1 m per radian."""
    straight = float(np.linalg.norm(np.subtract(end.position_m, start.position_m)))
    turn = float((start.rotation.inv() * end.rotation).magnitude())
    return max(straight, 0.1 * turn)
