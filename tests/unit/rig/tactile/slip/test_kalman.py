"""The filter of angle and rate is constant at rest and follows a motion immediately."""

import math

import numpy as np
import pytest

from rig.tactile.slip.kalman import RateFilter, unseen_variance
from rig.tactile.slip.parameters import MOTION

TOLD_DEG = 0.02
"""Reported noise of an alignment; the true noise of a frame is `MOTION.noise_ratio` times as large."""


def filtered(angles_deg: np.ndarray, rate_hz: float = 60.0, noisy: bool = True) -> np.ndarray:
    noise = (
        np.random.default_rng(3).normal(0.0, MOTION.noise_ratio * TOLD_DEG, len(angles_deg)) if noisy else 0.0
    )
    motion = RateFilter()
    return np.degrees(
        [
            motion.update(i / rate_hz, math.radians(angle), math.radians(TOLD_DEG))
            for i, angle in enumerate(angles_deg + noise)
        ]
    )


def test_noise_is_averaged_at_rest() -> None:
    result = filtered(np.zeros(20_000))[60:]
    assert result.std() < 0.85 * MOTION.noise_ratio * TOLD_DEG
    assert np.abs(result).max() < 3.8 * MOTION.noise_ratio * TOLD_DEG


@pytest.mark.parametrize("rate_hz", [30.0, 60.0])
@pytest.mark.parametrize("turn_deg_s", [-120.0, -20.0, 5.0, 60.0])
def test_slip_is_followed_from_its_first_frames(turn_deg_s: float, rate_hz: float) -> None:
    true = np.concatenate([np.zeros(120), turn_deg_s * np.arange(1, 31) / rate_hz])
    late = np.abs(filtered(true, rate_hz) - true)
    assert late[120:].max() < 8.0 * MOTION.noise_ratio * TOLD_DEG
    assert late[125:].mean() < 1.5 * MOTION.noise_ratio * TOLD_DEG


def test_creep_below_the_noise_is_followed() -> None:
    true = 1.0 * np.arange(300) / 60.0
    assert abs((filtered(true) - true)[60:].mean()) < 0.2 * MOTION.noise_ratio * TOLD_DEG


def test_without_noise_a_constant_rate_is_followed_exactly() -> None:
    true = 40.0 * np.arange(120) / 60.0
    assert np.abs(filtered(true, noisy=False) - true)[5:].max() < 1e-3


@pytest.mark.parametrize(
    ("rate_deg_s", "time_s", "sigma_deg"),
    [(0.0, 0.1, 1.5), (60.0, 0.1, 7.5), (0.0, 9.0, 180.0 / math.sqrt(12.0))],
)
def test_unobserved_turn_is_bounded_by_rate_and_time(
    rate_deg_s: float, time_s: float, sigma_deg: float
) -> None:
    variance = unseen_variance(math.radians(rate_deg_s), time_s)
    assert math.degrees(math.sqrt(variance)) == pytest.approx(sigma_deg)
