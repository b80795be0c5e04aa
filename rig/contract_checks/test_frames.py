"""The contract of every tactile sensor and camera: frames in order, at the rate, and not too old."""

import numpy as np
import pytest

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceTimeoutError, NotConnectedError, StaleFrameError
from drivers.interfaces import FrameSource

ABOUT = ("frames",)

LATE_S = 2.5
"""Longer than the backlog of any source."""


@pytest.fixture(params=["tactile", "camera"])
def source(bench: Bench, request: pytest.FixtureRequest) -> FrameSource:
    if request.param == "camera":
        sources = [bench.camera] if bench.has("camera") else []
    else:
        sources = [tip.sensor for tip in bench.fingertips]
    if not sources:
        pytest.skip(f"the bench file has no [{request.param}]")
    return sources[0]


def test_next_frames_are_in_order_at_the_rate_without_repeats(bench: Bench, source: FrameSource) -> None:
    source.newest_frame(1.0)
    frames = [source.next_frame(0.5) for _ in range(20)]
    assert np.diff([frame.sequence for frame in frames]).tolist() == [1] * 19
    periods = np.diff([frame.time_ns for frame in frames]) / 1e9
    assert periods.mean() == pytest.approx(1 / source.rate_hz, rel=0.05)
    assert all(frame.time_ns <= bench.clock.now_ns() for frame in frames)


def test_a_frame_is_rgb_and_carries_its_serial(source: FrameSource) -> None:
    frame = source.next_frame(0.5)
    assert frame.image.dtype == np.uint8
    assert frame.image.shape[2] == 3
    assert frame.serial == source.serial


def test_late_reader_loses_the_oldest_frames_with_a_gap(bench: Bench, source: FrameSource) -> None:
    first = source.next_frame(0.5)
    bench.clock.sleep_until(bench.clock.now_ns() + to_ns(LATE_S))
    assert source.next_frame(0.5).sequence > first.sequence + 1


def test_newest_frame_discards_the_backlog(bench: Bench, source: FrameSource) -> None:
    source.next_frame(0.5)
    bench.clock.sleep_until(bench.clock.now_ns() + to_ns(0.9))
    frame = source.newest_frame(0.4)
    assert bench.clock.now_ns() - frame.time_ns < to_ns(0.5)
    assert source.next_frame(0.5).sequence == frame.sequence + 1


def test_limits_on_age_and_waiting_raise(bench: Bench, source: FrameSource) -> None:
    with pytest.raises(StaleFrameError, match="old"):
        source.newest_frame(1e-6)
    source.newest_frame(1.0)
    with pytest.raises(DeviceTimeoutError, match="no frame"):
        source.next_frame(1e-6)


def test_frame_before_connect_raises_not_connected(source: FrameSource) -> None:
    source.disconnect()
    source.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        source.next_frame(0.1)
