"""Capture times and sequence numbers, from the times and numbers of the source."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from drivers.video.stream import CaptureTimes, RawFrame, SequenceCounter

PERIOD_NS = 16_666_667


@given(st.lists(st.integers(0, 50), min_size=2, max_size=40))
def test_numbers_of_the_source_are_kept_and_gaps_counted(steps: list[int]) -> None:
    count, number, seen = SequenceCounter(60.0), 0, []
    numbers = [number := number + 1 + step for step in steps]
    seen = [count.sequence_of(n, i * PERIOD_NS, True) for i, n in enumerate(numbers)]
    assert seen == numbers
    assert count.dropped == sum(steps[1:])


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(-2_500_000, 2_500_000)), min_size=1, max_size=40))
def test_missing_images_are_detected_from_kernel_times_despite_jitter(holes: list[tuple[int, int]]) -> None:
    count, slot = SequenceCounter(60.0), 20
    for n in range(20):
        count.sequence_of(None, n * PERIOD_NS, True)
    for lost, jitter_ns in holes:
        slot += lost
        count.sequence_of(None, slot * PERIOD_NS + jitter_ns, True)
        slot += 1
    assert count.dropped == sum(lost for lost, _ in holes)


def test_no_drops_are_counted_from_arrival_times() -> None:
    count = SequenceCounter(60.0)
    times_ns = [n * PERIOD_NS + (300_000_000 if n == 20 else 0) for n in range(20)] + [700_000_000]
    assert [count.sequence_of(None, t, False) for t in times_ns] == list(range(21))
    assert count.dropped == 0


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_sequence_continues_if_the_source_restarts_its_numbers(before: int, after: int) -> None:
    count = SequenceCounter(60.0)
    last = count.sequence_of(before, 0, True)
    count.note_opening(after_failure=True)
    first = count.sequence_of(after, 60 * PERIOD_NS, True)
    assert first > last
    assert count.sequence_of(after + 1, 61 * PERIOD_NS, True) == first + 1
    assert count.dropped == first - last - 1


def test_frames_before_reconnecting_are_not_counted_as_dropped() -> None:
    count = SequenceCounter(60.0)
    count.note_opening(after_failure=False)
    assert [count.sequence_of(number, number * PERIOD_NS, True) for number in (5, 10)] == [5, 10]
    assert count.dropped == 4
    count.note_opening(after_failure=False)
    assert count.sequence_of(500, 10**10, True) == 500
    assert count.dropped == 4


@given(st.lists(st.integers(-(10**9), 10**9), min_size=1, max_size=60))
def test_capture_times_increase_for_any_time_stamps(offsets: list[int]) -> None:
    times = CaptureTimes("peer")
    shots = [RawFrame(10**12 + n * PERIOD_NS, None, None, 10**12 + o) for n, o in enumerate(offsets)]
    seen = [times.time_of(shot) for shot in shots]
    assert all(a < b for a, b in pairwise(seen))
    assert all(time_ns <= shot.arrived_ns for time_ns, shot in zip(seen, shots, strict=True))


def test_first_time_stamp_determines_the_clock() -> None:
    ours, theirs = CaptureTimes("kernel"), CaptureTimes("kernel")
    assert ours.time_of(RawFrame(10**10, stamped_ns=10**10 - 5)) == 10**10 - 5
    assert ours.time_of(RawFrame(3 * 10**10, stamped_ns=10**10 + 5)) == 10**10 + 5  # late, and known to be
    assert theirs.time_of(RawFrame(10**10, stamped_ns=10**18)) == 10**10
    assert (ours.kind, theirs.kind) == ("kernel", "arrival")
