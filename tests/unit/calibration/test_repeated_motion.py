"""Clock offsets of motions that repeat: a repeated motion fits several offsets and must be refused."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.time_offset import TimedSignal, make_stream, time_offset
from calibration.verdict import Verdict

Array = np.ndarray

WAVES: dict[str, Callable[[Array], Array]] = {
    "sine": lambda cycles: np.sin(2 * np.pi * cycles),
    "triangle": lambda cycles: 2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles)),
    "pauses at both ends": lambda cycles: np.clip(1.8 * np.sin(2 * np.pi * cycles), -1, 1),
    "uneven": lambda cycles: np.sin(2 * np.pi * cycles) + 0.4 * np.sin(4 * np.pi * cycles + 1),
    "short presses": lambda cycles: np.exp(-(((cycles % 1 - 0.5) / 0.12) ** 2)),
}
OFFSETS_S = st.floats(-0.3, 0.3)
NOISE = st.sampled_from((0.0, 1e-4, 1e-3, 1e-2, 0.1))
RATES_HZ = st.sampled_from((50, 125, 500))
CAMERAS_HZ = st.sampled_from((25, 30, 60))


def _streams(
    motion: Callable[[Array], Array], offset_s: float, noise: float, rate_hz: int, camera_hz: float = 30.0
) -> tuple[TimedSignal, TimedSignal]:
    rng = np.random.default_rng(0)
    robot_s, camera_s = np.arange(0, 20, 1 / rate_hz), np.arange(0, 20, 1 / camera_hz) + 0.003
    camera_s = camera_s[rng.random(len(camera_s)) > 0.03]
    robot = motion(robot_s) + noise * rng.standard_normal(len(robot_s))
    camera = 3 * motion(camera_s) + 3 * noise * rng.standard_normal(len(camera_s))
    stamps = (np.rint(1e9 * t).astype(np.int64) for t in (robot_s, camera_s - offset_s))
    return make_stream(next(stamps), robot, "robot"), make_stream(next(stamps), camera, "camera")


@given(st.sampled_from(list(WAVES)), st.floats(0.1, 0.48), OFFSETS_S, NOISE, RATES_HZ, CAMERAS_HZ)
def test_steady_motion_is_refused_with_its_period(
    wave: str, period_s: float, offset_s: float, noise: float, rate_hz: int, camera_hz: float
) -> None:
    streams = _streams(lambda t: WAVES[wave](t / period_s), offset_s, noise, rate_hz, camera_hz)
    found = time_offset(*streams)
    assert found.assessment.verdict is Verdict.REFUSED
    assert found.offset_s is None


@pytest.mark.parametrize(("period_ms", "noise"), [(147, 0.0), (200, 1e-3), (300, 1e-2), (463, 0.0)])
@pytest.mark.parametrize("wave", WAVES)
def test_refusal_states_the_period(wave: str, noise: float, period_ms: float) -> None:
    found = time_offset(*_streams(lambda t: WAVES[wave](1e3 * t / period_ms), 0.037, noise, 50))
    reason = found.assessment.reasons[0]
    assert "move irregularly" in reason
    stated_ms = float(reason.split("every ")[1].split(" ms")[0])
    multiple = max(round(stated_ms / period_ms), 1)
    assert stated_ms == pytest.approx(multiple * period_ms, abs=6)


@given(
    st.integers(0, 1000), st.floats(0.15, 0.7), OFFSETS_S, st.sampled_from((0.0, 1e-4, 1e-3, 1e-2)), RATES_HZ
)
def test_to_and_fro_motion_with_uneven_periods_is_right_or_refused(
    seed: int, period_s: float, offset_s: float, noise: float, rate_hz: int
) -> None:
    """Periods that vary by 0.3 to 10 %, as by hand; the more they vary, the better the offset is known."""
    rng = np.random.default_rng(seed)
    wave = WAVES[str(rng.choice(list(WAVES)))]
    lengths = period_s * (1 + 10 ** rng.uniform(-2.5, -1) * rng.standard_normal(round(25 / period_s)))
    starts = np.concatenate([[-1.0], -1.0 + np.cumsum(np.abs(lengths))])
    streams = _streams(lambda t: wave(np.interp(t, starts, np.arange(len(starts)))), offset_s, noise, rate_hz)
    found = time_offset(*streams)
    if found.offset_s is not None:
        assert found.offset_s == pytest.approx(offset_s, abs=max(5 * (found.sigma_s or 0.0), 1.5e-3))


@given(st.integers(0, 1000), OFFSETS_S, st.sampled_from((0.0, 1e-4, 1e-3, 1e-2)), RATES_HZ)
def test_irregular_motion_is_accepted(seed: int, offset_s: float, noise: float, rate_hz: int) -> None:
    rng = np.random.default_rng(seed)
    tops_s = np.concatenate([[-1.0], -1.0 + np.cumsum(rng.uniform(0.3, 1.2, 80))])
    heights = rng.uniform(0.3, 1.0, len(tops_s)) * np.tile([1, -1], 41)[: len(tops_s)]
    found = time_offset(*_streams(lambda t: np.interp(t, tops_s, heights), offset_s, noise, rate_hz))
    assert found.assessment.verdict is Verdict.GOOD
    assert found.offset_s == pytest.approx(offset_s, abs=max(5 * (found.sigma_s or 0.0), 1e-3))
