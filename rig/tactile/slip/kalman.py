"""Estimate angle and rate from noisy angles: a constant-rate Kalman filter at the times of the frames.

At rest it averages the noise of the frames. When the angles deviate from the prediction, it follows
immediately (manoeuvre detection, see Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking
and Navigation, 2001, chapter 11).
"""

import math
from dataclasses import dataclass, field
from itertools import accumulate

from rig.tactile.slip.parameters import MOTION

Covariance = tuple[float, float, float]
"""Of angle and angle, angle and rate, rate and rate."""

# A manoeuvre is detected by the sum of at most this number of normalised innovations.
MOST_SURPRISES = 4
# Largest standard deviation: all angles within a half turn to either side are equally likely.
# Highest rotation rate of an object in a gripper.
MOST_RATE_RAD_S = math.radians(200.0)
ANY_TURN_RAD = math.pi / math.sqrt(12.0)


@dataclass(slots=True)
class RateFilter:
    """Angle (rad) and rate (rad/s) at `time_s`, and their covariance."""

    time_s: float | None = None
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0
    _covariance: Covariance = (0.0, 0.0, 0.0)
    _density: float = field(default_factory=lambda: MOTION.moving_density)
    _surprises: tuple[float, ...] = ()

    def restart(self) -> None:
        """Forget everything."""
        self.time_s, self._density, self._surprises = None, MOTION.moving_density, ()

    def predicted(self, time_s: float) -> float:
        """Return the angle expected at a time, rad."""
        if self.time_s is None:
            return 0.0
        return self.angle_rad + self.rate_rad_s * min(max(time_s - self.time_s, 0.0), MOTION.horizon_s)

    def update(self, time_s: float, angle_rad: float, sigma_rad: float) -> float:
        """Update with a measured angle and the noise of its alignment; return the filtered angle, rad."""
        noise = (MOTION.noise_ratio * sigma_rad) ** 2 + MOTION.least_noise_rad**2
        if self.time_s is None:
            self.angle_rad, self.rate_rad_s = angle_rad, 0.0
            self._covariance = (noise, 0.0, MOTION.first_rate_rad_s**2)
        else:
            elapsed_s = max(time_s - self.time_s, 0.0)  # below zero if a stream was restarted
            calmed = self._density * math.exp(-elapsed_s / MOTION.calming_s)
            self._density = max(MOTION.rest_density, calmed)
            predicted, covariance = self._ahead(elapsed_s)
            if self._moves((angle_rad - predicted) / math.sqrt(covariance[0] + noise)):
                self._density, self._surprises = MOTION.moving_density, ()
                predicted, covariance = self._ahead(elapsed_s)
            self._correct(predicted, covariance, angle_rad, noise)
        self.time_s = time_s
        return self.angle_rad

    def _moves(self, surprise: float) -> bool:
        """Add a normalised innovation; return whether the newest ones show a manoeuvre."""
        self._surprises = (*self._surprises, surprise)[-MOST_SURPRISES:]
        newest_first = accumulate(reversed(self._surprises))
        return any(abs(s) > MOTION.moves_sigmas * math.sqrt(n) for n, s in enumerate(newest_first, 1))

    def _ahead(self, dt: float) -> tuple[float, Covariance]:
        """Return the predicted angle and covariance after a time."""
        aa, ar, rr = self._covariance
        # White acceleration in continuous time. With an acceleration that is constant between frames, each
        # angle would be explained by one acceleration, and the rate would oscillate around the true one.
        return self.angle_rad + self.rate_rad_s * dt, (
            aa + dt * (2.0 * ar + dt * rr) + self._density * dt**3 / 3.0,
            ar + dt * rr + self._density * dt**2 / 2.0,
            rr + self._density * dt,
        )

    def _correct(self, predicted: float, covariance: Covariance, angle_rad: float, noise: float) -> None:
        aa, ar, rr = covariance
        surprise, spread = angle_rad - predicted, aa + noise
        self.angle_rad = predicted + aa / spread * surprise
        self.rate_rad_s += ar / spread * surprise
        self._covariance = (aa * noise / spread, ar * noise / spread, rr - ar * ar / spread)


def unseen_variance(rate_rad_s: float, elapsed_s: float) -> float:
    """Return the variance of a rotation that was not observed, from the last rate, rad^2.

    rate_rad_s: last observed rate; the object may have stopped or continued. elapsed_s: time since then.
    """
    speed = abs(rate_rad_s) + 0.5 * MOTION.acceleration_rad_s2 * elapsed_s
    return min(speed * elapsed_s, ANY_TURN_RAD) ** 2
