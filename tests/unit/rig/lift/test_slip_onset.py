"""Onset of the true rotation: ramps, noise, jolts, gaps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from rig.lift.onset import departure_ns, slip_onset_ns

MS = 1_000_000


def frames(count, rate_hz=60.0):
    return (np.arange(count) * 1e9 / rate_hz).astype(np.int64)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 120.0])
def test_onset_of_a_ramp_is_its_half_degree(sign, rate_hz):
    times = frames(int(2 * rate_hz), rate_hz)
    ramp = sign * np.maximum(0.0, times / 1e9 - 1.0) * 10.0
    onset = slip_onset_ns(times, ramp)
    assert onset is not None
    assert onset / 1e9 == pytest.approx(1.05, abs=0.004)


@given(st.integers(0, 10_000), st.sampled_from([1.0, -1.0]), st.floats(2.0, 60.0))
def test_onset_of_a_noisy_stick_slip_ramp(seed, sign, rate_deg_s):
    """A ramp with steps every 40 ms, with the noise of the two-marker angle.

    The noise is limited so that two frames of one step differ by less than `MOST_FALL_DEG`. A larger
    difference is a fall, after which growth begins again; it happens in 1 of 1000 ramps.
    """
    times = frames(150)
    stepped = np.floor(np.maximum(0.0, times / 1e9 - 1.0) / 0.04) * 0.04
    noise = np.random.default_rng(seed).normal(0.0, 0.02, 150).clip(-0.049, 0.049)
    angles = sign * stepped * rate_deg_s + noise
    onset = slip_onset_ns(times, angles)
    assert onset is not None
    assert -0.06 < onset / 1e9 - (1.0 + 0.5 / rate_deg_s) < 0.12


@given(st.integers(0, 10_000))
def test_noise_gives_no_onset(seed):
    assert slip_onset_ns(np.array([], np.int64), np.array([])) is None
    times = frames(600)
    noise = np.random.default_rng(seed).normal(0.0, 0.03, 600)
    assert slip_onset_ns(times, noise) is None
    settled = noise / 2 + np.clip(times / 1e9 - 2.0, 0.0, 1.0) * 0.45
    assert slip_onset_ns(times, settled) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_jolt_that_returns_gives_no_onset(sign):
    times = frames(120)
    jolt = np.where((times > 1_000 * MS) & (times < 1_060 * MS), sign * 2.0, 0.0)
    assert slip_onset_ns(times, jolt) is None
    later = jolt + sign * np.maximum(0.0, times / 1e9 - 1.5) * 20.0
    onset = slip_onset_ns(times, later)
    assert onset is not None
    assert onset / 1e9 == pytest.approx(1.525, abs=0.005)


def test_growth_during_a_gap_gives_no_onset():
    times = frames(120)
    ramp = np.maximum(0.0, times / 1e9 - 1.0) * 10.0
    ended = times < 1_140 * MS
    assert slip_onset_ns(times[ended], ramp[ended]) is None
    times, ramp = times[times < 1_200 * MS], ramp[times < 1_200 * MS]
    assert slip_onset_ns(times, ramp) is not None
    gap = (times < 1_055 * MS) | (times > 1_110 * MS)
    assert slip_onset_ns(times[gap], ramp[gap]) is None


@pytest.mark.parametrize(
    ("times", "angles"),
    [([0, 1], [0.0]), ([0, 1], [0.0, np.nan]), ([1, 1], [0.0, 0.0]), ([2, 1], [0.0, 0.0])],
)
def test_onset_rejects_an_invalid_series(times, angles):
    with pytest.raises(InputError, match="slip onset"):
        slip_onset_ns(np.array(times, np.int64), np.array(angles))


def test_departure_is_measured_from_the_given_rest_angle() -> None:
    time_ns = np.arange(6, dtype=np.int64) * 33_000_000
    angle = np.array([2.0, 2.0, 2.25, 2.75, 2.75, 2.75])
    assert departure_ns(time_ns, angle, 2.0) == round(2.5 * 33_000_000)
    assert departure_ns(time_ns, angle, 2.5) == 0
    assert departure_ns(time_ns[:3], angle[:3], 2.0) is None
