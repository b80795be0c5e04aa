"""Counting of dropped frames and of frames with an invalid time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.tally import FrameTally, StreamTimes
from drivers.types import Frame


def frame(number: int, brightness: int) -> Frame:
    return Frame(np.full((2, 3, 3), brightness, np.uint8), number, number, "D1")


@given(st.sets(st.integers(0, 60), min_size=1))
def test_gaps_in_sequence_numbers_count_as_drops(numbers: set[int]) -> None:
    tally = FrameTally()
    for number in sorted(numbers):
        tally.add(frame(number, number))
    assert tally.frames == len(numbers)
    assert tally.dropped == len(set(range(min(numbers), max(numbers) + 1)) - numbers)


SECOND_NS, PERIOD_NS = 1_000_000_000, 16_666_667


def followed(times_ns: list[int]) -> list[bool]:
    times = StreamTimes()
    return [times.follows(time_ns) for time_ns in times_ns]


@pytest.mark.parametrize("jump_s", [-3600, -3, -1, 1, 3, 3600, 1e8])
@pytest.mark.parametrize("place", [3, 17, 29])
def test_jumped_time_discards_only_its_frame(jump_s: float, place: int) -> None:
    times_ns = [10 * SECOND_NS + n * PERIOD_NS for n in range(30)]
    times_ns[place] += round(jump_s * SECOND_NS)
    assert followed(times_ns) == [n != place for n in range(30)]


@pytest.mark.parametrize("pause_s", [-3600, 3, 3600])
def test_pause_or_reset_clock_discards_one_frame(pause_s: float) -> None:
    before = [10 * SECOND_NS + n * PERIOD_NS for n in range(10)]
    after = [before[-1] + round(pause_s * SECOND_NS) + n * PERIOD_NS for n in range(10)]
    assert followed(before + after) == [True] * 10 + [False] + [True] * 9


def test_late_repeated_and_slow_frames_are_not_jumps() -> None:
    assert all(followed([0, PERIOD_NS, 2 * PERIOD_NS, PERIOD_NS, 2 * PERIOD_NS, 3 * PERIOD_NS]))
    assert all(followed([n * 60 * SECOND_NS for n in range(10)]))  # a picture a minute
    assert followed([0, PERIOD_NS, 2 * SECOND_NS, 4 * SECOND_NS, 6 * SECOND_NS]) == [
        True,
        True,
        False,
        True,
        True,
    ]


@given(st.lists(st.integers(0, 2**63 - 1), max_size=40))
def test_stream_is_never_abandoned_after_jumped_times(times_ns: list[int]) -> None:
    times = StreamTimes()
    for time_ns in times_ns:
        times.follows(time_ns)
    start = times_ns[-1] if times_ns else 0
    assert all([times.follows(start + n * PERIOD_NS) for n in range(5)][2:])


def test_tally_counts_jumped_frames() -> None:
    tally = FrameTally()
    for number in range(10):
        tally.add(
            replace(frame(number, number), time_ns=number * PERIOD_NS + 3600 * SECOND_NS * (number == 5))
        )
        assert tally.out_of_time is (number == 5)
    assert (tally.frames, tally.dropped, tally.jumped) == (10, 0, 1)
