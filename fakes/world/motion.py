"""Timed paths of the simulated tool and fingers, with trapezoidal speed profiles."""

import math
from dataclasses import dataclass, field, replace

from scipy.spatial.transform import Rotation, Slerp

from drivers.clock import NS_PER_S
from drivers.types import Pose
from fakes.faults import DRIFT_COUNTS, DRIFT_COUNTS_S


@dataclass(frozen=True, slots=True)
class TrapezoidProfile:
    """Trapezoidal speed profile over a `distance` (any unit), from `start_ns` on.

    speed, acceleration, deceleration: in the distance's unit per s and per s^2. stop_fraction: fraction of
    the distance at which a motion that was cut short stays. brake_ns: time of a brake command, after which
    the motion decelerates to rest; None without one.
    """

    start_ns: int
    distance: float
    speed: float
    acceleration: float
    stop_fraction: float = 1.0
    brake_ns: int | None = None
    deceleration: float = 1.0
    duration_s: float = field(init=False)
    """Duration of the whole motion without a stop, s."""
    _ramp_s: float = field(init=False)

    def __post_init__(self) -> None:
        ramp = min(self.speed / self.acceleration, math.sqrt(self.distance / self.acceleration))
        cruise = self.distance - self.acceleration * ramp * ramp
        duration = 2.0 * ramp + max(cruise, 0.0) / self.speed if self.distance > 0.0 else 0.0
        object.__setattr__(self, "_ramp_s", ramp)
        object.__setattr__(self, "duration_s", duration)

    def fraction_at(self, time_ns: int) -> float:
        """Return the fraction of the distance covered at `time_ns`, 0 to 1."""
        if self.brake_ns is not None and time_ns > self.brake_ns:
            speed = self._speed_at(self.brake_ns)
            spent = min((time_ns - self.brake_ns) / NS_PER_S, speed / self.deceleration)
            covered = speed * spent - 0.5 * self.deceleration * spent**2
            return self._uncut_fraction_at(self.brake_ns) + covered / self.distance
        return min(self._uncut_fraction_at(time_ns), self.stop_fraction)

    def done_at(self, time_ns: int) -> bool:
        """Whether the motion has ended, by a stop or at its target."""
        if self.brake_ns is not None:
            braked_s = self._speed_at(self.brake_ns) / self.deceleration
            return time_ns >= self.brake_ns + round(braked_s * NS_PER_S)
        return self._uncut_fraction_at(time_ns) >= self.stop_fraction

    def braked_at(self, time_ns: int, deceleration: float) -> "TrapezoidProfile":
        """Return the motion with a brake command at `time_ns`; unchanged if it brakes already or has ended.

        The deceleration is at least the acceleration, so that the motion never passes its target.
        """
        if self.brake_ns is not None or self.done_at(time_ns):
            return self
        return replace(self, brake_ns=time_ns, deceleration=max(deceleration, self.acceleration))

    def _speed_at(self, time_ns: int) -> float:
        elapsed = (time_ns - self.start_ns) / NS_PER_S
        return self.acceleration * max(0.0, min(elapsed, self._ramp_s, self.duration_s - elapsed))

    def _uncut_fraction_at(self, time_ns: int) -> float:
        duration = self.duration_s
        elapsed = (time_ns - self.start_ns) / NS_PER_S
        if elapsed >= duration:
            return 1.0
        if elapsed <= 0.0:
            return 0.0
        ramp = self._ramp_s
        if elapsed < ramp:
            covered = 0.5 * self.acceleration * elapsed**2
        elif elapsed > duration - ramp:
            covered = self.distance - 0.5 * self.acceleration * (duration - elapsed) ** 2
        else:
            covered = self.acceleration * ramp * (elapsed - 0.5 * ramp)
        return covered / self.distance


AT_REST = TrapezoidProfile(0, 0.0, 1.0, 1.0)
"""Profile of a motion over the distance 0."""


@dataclass(frozen=True, slots=True)
class ToolPath:
    """A straight motion of the tool centre point over time."""

    start: Pose
    end: Pose
    profile: TrapezoidProfile
    _tilts_rad: tuple[float, float]

    @classmethod
    def between(cls, start: Pose, end: Pose, profile: TrapezoidProfile) -> "ToolPath":
        return cls(start, end, profile, (tool_tilt(start), tool_tilt(end)))

    @classmethod
    def resting(cls, pose: Pose) -> "ToolPath":
        return cls.between(pose, pose, AT_REST)

    def position_at(self, time_ns: int) -> tuple[float, float, float]:
        """Return the position in the base frame, m."""
        f = self.profile.fraction_at(time_ns)
        (x0, y0, z0), (x1, y1, z1) = self.start.position_m, self.end.position_m
        return x0 + f * (x1 - x0), y0 + f * (y1 - y0), z0 + f * (z1 - z0)

    def pose_at(self, time_ns: int) -> Pose:
        """Return `base_T_tcp`; the orientation is interpolated spherically (slerp)."""
        f = self.profile.fraction_at(time_ns)
        if f >= 1.0 or self.start.quaternion_xyzw == self.end.quaternion_xyzw:
            return Pose(self.position_at(time_ns), self.end.quaternion_xyzw)
        turn = Slerp([0.0, 1.0], Rotation.concatenate([self.start.rotation, self.end.rotation]))
        return Pose.from_rotation(self.position_at(time_ns), turn(f))

    def tilt_at(self, time_ns: int) -> float:
        """Return the tool's rotation about the base's -y axis, rad, counter-clockwise in the camera image."""
        f = self.profile.fraction_at(time_ns)
        start, end = self._tilts_rad
        return start + f * (end - start)

    def braked_at(self, time_ns: int, deceleration_m_s2: float) -> "ToolPath":
        """Return the same path with a brake command at `time_ns`."""
        return replace(self, profile=self.profile.braked_at(time_ns, deceleration_m_s2))


FINGER_ACCELERATION = 2000.0
"""Acceleration of simulated fingers, counts/s^2."""


@dataclass(frozen=True, slots=True)
class FingerPath:
    """A motion of the grasping fingers over time, in counts."""

    start: float
    end: float
    profile: TrapezoidProfile

    @classmethod
    def resting(cls, counts: float) -> "FingerPath":
        return cls(counts, counts, AT_REST)

    def position_at(self, time_ns: int) -> float:
        return self.start + self.profile.fraction_at(time_ns) * (self.end - self.start)

    def sent_to(self, end: float, speed: float, now_ns: int) -> "FingerPath":
        """Return a motion from the position now to `end`, in counts and counts per second."""
        start = self.position_at(now_ns)
        return FingerPath(start, end, TrapezoidProfile(now_ns, abs(end - start), speed, FINGER_ACCELERATION))

    def drifting(self, lowest: float, now_ns: int) -> "FingerPath":
        """Return the motion of the fault `drift`. lowest: position of open fingers, counts."""
        return self.sent_to(max(self.position_at(now_ns) - DRIFT_COUNTS, lowest), DRIFT_COUNTS_S, now_ns)

    def cut_at(self, time_ns: int) -> "FingerPath":
        """Return the same path, stopped at `time_ns`."""
        return replace(self, profile=replace(self.profile, stop_fraction=self.profile.fraction_at(time_ns)))


def tool_tilt(base_T_tcp: Pose) -> float:  # noqa: N803
    """Return the rotation of a downward tool about the base's -y axis, rad, from its x axis."""
    x_axis = base_T_tcp.rotation.apply([1.0, 0.0, 0.0])
    return math.atan2(float(x_axis[2]), float(x_axis[0]))


def distance(start: Pose, end: Pose) -> float:
    """Return the length of a straight motion, m; a pure rotation counts as 0.1 m per rad."""
    straight_m, turn_rad = start.apart(end)
    return max(straight_m, 0.1 * turn_rad)
