"""How simulated actuators move from one value to another: with a trapezoidal speed profile."""

import math
from dataclasses import dataclass, replace

from drivers.clock import NS_PER_S


@dataclass(frozen=True, slots=True)
class TrapezoidProfile:
    """Trapezoidal speed over a `distance` (any unit), from `start_ns` on.

    speed and acceleration are in the distance's unit per s and per s^2. `fraction_at` runs
    from 0 to 1. A motion that was cut short stays at its `stop_fraction`; one that was told to brake
    goes on from `brake_ns` until it stands.
    """

    start_ns: int
    distance: float
    speed: float
    acceleration: float
    stop_fraction: float = 1.0
    brake_ns: int | None = None
    deceleration: float = 1.0

    @property
    def _ramp_s(self) -> float:
        return min(self.speed / self.acceleration, math.sqrt(self.distance / self.acceleration))

    @property
    def duration_s(self) -> float:
        """Duration of the whole motion, had it not been cut short, s."""
        if self.distance <= 0.0:
            return 0.0
        ramp = self._ramp_s
        cruise = self.distance - self.acceleration * ramp * ramp
        return 2.0 * ramp + max(cruise, 0.0) / self.speed

    def fraction_at(self, time_ns: int) -> float:
        """Share of the distance covered at `time_ns`."""
        if self.brake_ns is not None and time_ns > self.brake_ns:
            return self._braking_fraction_at(time_ns, self.brake_ns)
        return min(self._uncut_fraction_at(time_ns), self.stop_fraction)

    def done_at(self, time_ns: int) -> bool:
        """Whether the motion (cut short or not) has ended."""
        if self.brake_ns is not None:
            braked_s = self._speed_at(self.brake_ns) / self.deceleration
            return time_ns >= self.brake_ns + round(braked_s * NS_PER_S)
        return self._uncut_fraction_at(time_ns) >= self.stop_fraction

    def braked_at(self, time_ns: int, deceleration: float) -> "TrapezoidProfile":
        """The same motion told to brake at `time_ns`; one that brakes or has ended stays as it is.

        It never brakes more gently than it slows down, so that it stays short of its end.
        """
        if self.brake_ns is not None or self.done_at(time_ns):
            return self
        return replace(self, brake_ns=time_ns, deceleration=max(deceleration, self.acceleration))

    def _braking_fraction_at(self, time_ns: int, brake_ns: int) -> float:
        speed = self._speed_at(brake_ns)
        spent = min((time_ns - brake_ns) / NS_PER_S, speed / self.deceleration)
        covered = speed * spent - 0.5 * self.deceleration * spent**2
        return self._uncut_fraction_at(brake_ns) + covered / self.distance

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
