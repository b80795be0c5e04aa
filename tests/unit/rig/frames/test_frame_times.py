"""Run times of estimates: frames without contact, which need nearly no time, do not count."""

import pytest

from rig.frames.estimates import Estimate, contact_ms, figures, frame_ms, zeroed
from rig.frames.times import FrameTime
from rig.tactile.sample import SlipSample, State


def sample(number: int, state: State, cost_s: float | None, jumped: bool = False) -> SlipSample:
    time_ns = number * 10_000_000
    angle_deg = 0.0 if state is State.TRACKING else None
    return SlipSample(time_ns, state, angle_deg, contact_area_px=900.0, jumped=jumped, cost_s=cost_s)


SAMPLES = [
    *(sample(number, State.NO_CONTACT, 0.0005) for number in range(20)),
    *(sample(20 + number, State.TRACKING, 0.001 * (number + 1)) for number in range(11)),
    sample(31, State.LOST, None),  # could not be read
    sample(32, State.LOST, 0.0001, jumped=True),  # was not processed
    sample(33, State.UNOBSERVABLE, 0.012),
]


def estimate(samples: list[SlipSample]) -> Estimate:
    times = tuple(FrameTime(str(sample.time_s), sample.time_ns) for sample in samples)
    return zeroed(Estimate(times, tuple(samples)), None)


def test_only_processed_frames_with_contact_are_timed() -> None:
    assert contact_ms(SAMPLES) == pytest.approx([float(ms) for ms in range(1, 13)])


def test_estimate_reports_median_90_and_99_percent_over_frames_with_contact() -> None:
    found = figures(estimate(SAMPLES))
    assert (found.median_ms, found.p90_ms, found.p99_ms) == pytest.approx((6.5, 10.9, 11.89))


def test_series_without_contact_has_no_time() -> None:
    found = figures(estimate(SAMPLES[:20]))
    assert (found.median_ms, found.p90_ms, found.p99_ms) == (None, None, None)
    assert frame_ms([]) is None
