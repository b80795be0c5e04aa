"""Angle and rate over time from noisy angles: a constant-rate Kalman filter at the frames' own times."""

import math
from dataclasses import dataclass

# Spectral density of the angular acceleration, rad^2/s^3: stick and slip changes the rate by some
# 30 degrees/s within a frame or two, and the filter must not hold the angle back.
ACCELERATION_DENSITY = 4.0
# What an alignment's noise does not tell of a measured angle: about this much is seen at rest.
LEAST_NOISE_RAD = math.radians(0.03)
FIRST_RATE_RAD_S = 0.5
# A rate says nothing of what an object does after so long.
HORIZON_S = 0.1


@dataclass(slots=True)
class RateFilter:
    """Angle (rad) and rate (rad/s) at `time_s`, and their covariance."""

    time_s: float | None = None
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0
    _covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of angle and angle, angle and rate, rate and rate."""

    def restart(self) -> None:
        """Forget everything."""
        self.time_s = None

    def predicted(self, time_s: float) -> float:
        """Return the angle expected at a time, rad."""
        if self.time_s is None:
            return 0.0
        return self.angle_rad + self.rate_rad_s * min(time_s - self.time_s, HORIZON_S)

    def update(self, time_s: float, angle_rad: float, sigma_rad: float) -> float:
        """Take an angle measured at a time; return the filtered one, rad."""
        noise = sigma_rad**2 + LEAST_NOISE_RAD**2
        if self.time_s is None:
            self.angle_rad, self.rate_rad_s = angle_rad, 0.0
            self._covariance = (noise, 0.0, FIRST_RATE_RAD_S**2)
        else:
            self._predict(time_s - self.time_s)
            self._correct(angle_rad, noise)
        self.time_s = time_s
        return self.angle_rad

    def _predict(self, dt: float) -> None:
        aa, ar, rr = self._covariance
        self.angle_rad += self.rate_rad_s * dt
        # White acceleration in continuous time: were it constant from frame to frame, each angle would
        # be explained by one acceleration and the rate would swing to and fro around the true one.
        self._covariance = (
            aa + dt * (2.0 * ar + dt * rr) + ACCELERATION_DENSITY * dt**3 / 3.0,
            ar + dt * rr + ACCELERATION_DENSITY * dt**2 / 2.0,
            rr + ACCELERATION_DENSITY * dt,
        )

    def _correct(self, angle_rad: float, noise: float) -> None:
        aa, ar, rr = self._covariance
        surprise, spread = angle_rad - self.angle_rad, aa + noise
        self.angle_rad += aa / spread * surprise
        self.rate_rad_s += ar / spread * surprise
        self._covariance = (aa * noise / spread, ar * noise / spread, rr - ar * ar / spread)
