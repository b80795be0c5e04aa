"""One fingertip's noise at rest, and whether its later answers show a slip."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from rig.lift.fusion import TipAnswer

AGREES = 0.4
"""Every answering fingertip must show this fraction of a slip, because an object rotates under all of
them."""
GIVES_DEG = 0.3
"""Largest rotation by which a holding gel yields under the weight; that is no slip (contract: 0.5 is)."""
DRIFTS_S = 5.0
"""Time constant with which the rest angle follows a drifting fingertip; no slip is that slow."""
REST_NS = 100_000_000
"""A fingertip without rotation for this long is at rest."""
GROWTH_NS = 50_000_000
"""Interval over which the growth of the rate is measured."""
LEAST_NOISE_DEG, LEAST_NOISE_DEG_S = 0.002, 0.02
"""Lower bounds of the noise: no image resolves less, and without noise the estimator did not process the
image."""


def sigmas_for(false_alarms_per_hour: float, answers_per_s: float) -> float:
    """Return the number of sigmas by which angle and rate must both leave rest.

    The answers of a resting fingertip are assumed independent, and angle and rate independent and normal.
    Then an answer is a false alarm with twice the square of the one-sided tail (either direction). Raises
    `InputError` for a rate that no threshold gives.
    """
    share = false_alarms_per_hour / (3600.0 * answers_per_s)
    if not 0.0 < share < 0.5:
        raise InputError(
            f"--alarms-per-hour {false_alarms_per_hour:g} is out of range for {answers_per_s:.0f} "
            "answers per second: give more than 0 and less than half as many as there are"
        )
    return -NormalDist().inv_cdf(math.sqrt(share / 2.0))


@dataclass(slots=True)
class TipWatch:
    """One fingertip's noise at rest, and its answers since. Angles from the trial's zero."""

    angle_deg: float
    rate_deg_s: float
    base_deg: float = 0.0
    sigma_deg: float = 1.0
    _seen: deque[tuple[int, float, float]] = field(default_factory=deque)

    @classmethod
    def resting(cls, answers: Sequence[TipAnswer], false_alarms_per_hour: float) -> "TipWatch | None":
        """Estimate thresholds from answers at rest; None if too few have a rate."""
        known = [
            (a.sample.time_ns, a.angle_deg, a.rate_deg_s)
            for a in answers
            if a.angle_deg is not None and a.rate_deg_s is not None
        ]
        if len(known) < 10:
            return None
        times, angles, rates = (np.array(column, float) for column in zip(*known, strict=True))
        sigmas = sigmas_for(false_alarms_per_hour, NS_PER_S / float(np.median(np.diff(times))))
        angle = sigmas * max(float(np.std(angles)), LEAST_NOISE_DEG)
        return cls(angle, sigmas * max(float(np.sqrt(np.mean(rates**2))), LEAST_NOISE_DEG_S))

    def update(self, answer: TipAnswer) -> None:
        """Process an answer since the lift began; refused ones are ignored."""
        if answer.angle_deg is None or answer.rate_deg_s is None:
            return
        time_ns = answer.sample.time_ns
        if self._seen:
            spent_s = (time_ns - self._seen[-1][0]) / NS_PER_S
            self.base_deg += (answer.angle_deg - self.base_deg) * min(spent_s / DRIFTS_S, 1.0)
        self._seen.append((time_ns, answer.angle_deg, answer.rate_deg_s))
        while time_ns - self._seen[0][0] > REST_NS:
            self._seen.popleft()
        self.sigma_deg = answer.sample.sigma_deg or self.sigma_deg

    @property
    def away_deg(self) -> float:
        """Rotation since rest, deg."""
        return self._seen[-1][1] - self.base_deg if self._seen else 0.0

    @property
    def newest_rate_deg_s(self) -> float:
        """Newest angular rate, deg/s."""
        return self._seen[-1][2] if self._seen else 0.0

    def slips(self, away_deg: float, agreed_deg: float) -> bool:
        """Whether the fingertip is rotating, and has rotated far enough for a slip.

        away_deg: rotation since rest, mean of all fingertips. agreed_deg: smallest one in that direction.
        """
        rate = self.newest_rate_deg_s
        turning = abs(rate) >= self.rate_deg_s and away_deg * rate > 0.0
        least_deg = GIVES_DEG + self.angle_deg
        return turning and min(abs(away_deg), abs(self.away_deg), agreed_deg / AGREES) >= least_deg

    def weight(self, now_ns: int) -> float:
        """Weight among the fingertips: inverse variance of its newest answer; 0 without a recent one."""
        lately = self._seen and now_ns - self._seen[-1][0] <= REST_NS
        return 1.0 / max(self.sigma_deg, LEAST_NOISE_DEG) ** 2 if lately else 0.0

    def predicted_deg(self, after_s: float) -> float:
        """Return the rotation after a time, from the newest angle, its rate and the rate's growth."""
        if not self._seen:
            return 0.0
        time_ns, angle, rate = self._seen[-1]
        before = next(s for s in self._seen if time_ns - s[0] <= GROWTH_NS)
        spent_s = (time_ns - before[0]) / NS_PER_S
        growth = (abs(rate) - abs(before[2])) / spent_s if spent_s > 0.0 else 0.0
        return abs(angle) + abs(rate) * after_s + 0.5 * max(growth, 0.0) * after_s**2

    def at_rest(self, now_ns: int) -> bool | None:
        """Whether no rotation was detected for `REST_NS`; None without an answer in that time."""
        late = [rate for time_ns, _, rate in self._seen if now_ns - time_ns <= REST_NS]
        return all(abs(rate) < self.rate_deg_s for rate in late) if late else None

    def rearm(self) -> None:
        """Start to detect the next slip, from the present angle."""
        if self._seen:
            self.base_deg = float(np.mean([angle for _, angle, _ in self._seen]))
