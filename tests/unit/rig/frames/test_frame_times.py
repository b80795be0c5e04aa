"""Run times of estimates: frames without contact, which need nearly no time, do not count."""

import pytest

from rig.frames.estimates import Answer, contact_ms, figures, frame_ms, zeroed
from rig.frames.times import FrameTime
from rig.tactile.sample import SlipSample, State


def answer(number: int, state: State, cost_s: float | None, jumped: bool = False) -> Answer:
    time_ns = number * 10_000_000
    angle_deg = 0.0 if state is State.TRACKING else None
    sample = SlipSample(time_ns, state, angle_deg, contact_area_px=900.0, jumped=jumped)
    return Answer(FrameTime(f"{number / 100}", time_ns), sample, cost_s)


ANSWERS = [
    *(answer(number, State.NO_CONTACT, 0.0005) for number in range(20)),
    *(answer(20 + number, State.TRACKING, 0.001 * (number + 1)) for number in range(11)),
    answer(31, State.LOST, None),  # could not be read
    answer(32, State.LOST, 0.0001, jumped=True),  # was not processed
    answer(33, State.UNOBSERVABLE, 0.012),
]


def test_only_processed_frames_with_contact_are_timed() -> None:
    assert contact_ms(ANSWERS) == pytest.approx([float(ms) for ms in range(1, 13)])


def test_estimate_reports_median_90_and_99_percent_over_frames_with_contact() -> None:
    found = figures(zeroed(ANSWERS, None))
    assert (found.median_ms, found.p90_ms, found.p99_ms) == pytest.approx((6.5, 10.9, 11.89))


def test_series_without_contact_has_no_time() -> None:
    found = figures(zeroed(ANSWERS[:20], None))
    assert (found.median_ms, found.p90_ms, found.p99_ms) == (None, None, None)
    assert frame_ms([]) is None
