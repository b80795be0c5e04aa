"""Angle and rate over time from noisy angles: a constant-rate Kalman filter at the frames' own times."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# Angular acceleration that a slip reaches, rad/s^2 (one sigma, white): a slip starts within a frame
# or two, so the filter must not hold the angle back.
ACCELERATION_RAD_S2 = 40.0
FIRST_RATE_RAD_S = 0.5
# A rate says nothing of what an object does after so long.
HORIZON_S = 0.1


@dataclass(slots=True)
class RateFilter:
    """State: angle (rad) and rate (rad/s) with their covariance, at `time_s`."""

    time_s: float | None = None
    state: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((2, 2)))

    @property
    def rate_rad_s(self) -> float:
        """Newest rate, rad/s."""
        return float(self.state[1])

    def restart(self) -> None:
        """Forget everything."""
        self.time_s = None

    def predicted(self, time_s: float) -> float:
        """Return the angle expected at a time, rad."""
        if self.time_s is None:
            return 0.0
        return float(self.state[0] + self.state[1] * min(time_s - self.time_s, HORIZON_S))

    def update(self, time_s: float, angle_rad: float, sigma_rad: float) -> float:
        """Take an angle measured at a time; return the filtered one, rad."""
        if self.time_s is None:
            self.state = np.array([angle_rad, 0.0])
            self.covariance = np.diag([sigma_rad**2, FIRST_RATE_RAD_S**2])
            self.time_s = time_s
            return angle_rad
        self._predict(time_s - self.time_s)
        self.time_s = time_s
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + sigma_rad**2)
        self.state = self.state + gain * (angle_rad - self.state[0])
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])
        return float(self.state[0])

    def _predict(self, dt: float) -> None:
        f = np.array([[1.0, dt], [0.0, 1.0]])
        noise = np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]]) * ACCELERATION_RAD_S2**2
        self.state = f @ self.state
        self.covariance = f @ self.covariance @ f.T + noise
