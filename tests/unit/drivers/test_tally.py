"""Dropped frames, frames with an invalid time, and copies of pictures in any encoding."""

from collections.abc import Callable, Iterator
from itertools import islice

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import NS_PER_S
from drivers.errors import StaleFrameError
from drivers.tally import (
    FROZEN_NS,
    FROZEN_REPEATS,
    LEARNT_PICTURES,
    SELDOM_NS,
    FrameTally,
    PictureNews,
    StreamTimes,
    new_pictures,
)
from drivers.types import Frame, Image
from fakes.gel.sensor import GelSensor

SECOND_NS, PERIOD_NS = 1_000_000_000, 16_666_667


def frame(number: int, time_ns: int = 0) -> Frame:
    return Frame(np.zeros((2, 3, 3), np.uint8), time_ns or number, number, "D1")


@given(st.sets(st.integers(0, 60), min_size=1))
def test_gaps_in_sequence_numbers_count_as_drops(numbers: set[int]) -> None:
    tally = FrameTally()
    for number in sorted(numbers):
        tally.add(frame(number))
    assert tally.frames == len(numbers)
    assert tally.dropped == len(set(range(min(numbers), max(numbers) + 1)) - numbers)


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
def test_pause_or_reset_clock_discards_one_frame(pause_s: int) -> None:
    before = [10 * SECOND_NS + n * PERIOD_NS for n in range(10)]
    after = [before[-1] + pause_s * SECOND_NS + n * PERIOD_NS for n in range(10)]
    assert followed(before + after) == [True] * 10 + [False] + [True] * 9


def test_late_repeated_and_slow_frames_are_not_jumps() -> None:
    assert all(followed([0, PERIOD_NS, 2 * PERIOD_NS, PERIOD_NS, 2 * PERIOD_NS, 3 * PERIOD_NS]))
    assert all(followed([n * 60 * SECOND_NS for n in range(10)]))  # a picture a minute
    paused = [0, PERIOD_NS, 2 * SECOND_NS, 4 * SECOND_NS, 6 * SECOND_NS]
    assert followed(paused) == [True, True, False, True, True]


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
        tally.add(frame(number, number * PERIOD_NS + 3600 * SECOND_NS * (number == 5)))
        assert tally.out_of_time is (number == 5)
    assert (tally.frames, tally.dropped, tally.jumped) == (10, 0, 1)


LIVE = 60
"""Live pictures before the stream freezes: 1 s."""
Copy = Callable[[Image, int], Image]


def encoded(image: Image, quality: int) -> Image:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def one_pixel(image: Image, number: int) -> Image:
    rng = np.random.default_rng(number)
    copy = image.copy()
    copy[rng.integers(image.shape[0]), rng.integers(image.shape[1])] = rng.integers(256, size=3)
    return copy


COPIES: dict[str, Copy] = {
    "the same bytes": lambda image, number: image,
    "one changed pixel": one_pixel,
    "one changed pixel, encoded again": lambda image, number: encoded(one_pixel(image, number), 95),
    "other JPEG qualities": lambda image, number: encoded(image, 90 + number % 8),
    "two JPEG qualities in turn": lambda image, number: encoded(image, 60 + 35 * (number % 2)),
    "a line of text": lambda image, number: cv2.putText(image.copy(), f"{number}", (2, 8), 0, 0.3, 255),  # type: ignore[dict-item]
}


def live(seed: int, quality: int = 95) -> Iterator[Image]:
    gel, rng = GelSensor(seed), np.random.default_rng(seed)
    while True:
        yield encoded(gel.render(None, 0.0, rng), quality)


def states(pictures: list[Image], period_ns: int = PERIOD_NS, every_ns: int = 0) -> list[bool]:
    news, found = PictureNews(every_ns), []
    for number, image in enumerate(pictures):
        news.add(image, number * period_ns)
        found.append(news.frozen)
    return found


@pytest.mark.parametrize("every_ns", [0, SELDOM_NS])
@pytest.mark.heavy
@pytest.mark.parametrize("name", COPIES)
def test_copies_are_frozen_after_the_limit_until_pictures_change(name: str, every_ns: int) -> None:
    source = live(3)
    before = [next(source) for _ in range(LIVE)]
    copies = [COPIES[name](before[-1], number) for number in range(90)]
    found = states(before + copies + [next(source) for _ in range(LIVE)], every_ns=every_ns)
    assert not any(found[:LIVE])
    late = FROZEN_NS // PERIOD_NS + 2
    assert all(found[LIVE + late : LIVE + 90])
    assert not any(found[LIVE : LIVE + late - 4])
    assert not any(found[LIVE + 90 :]), "live again"


@pytest.mark.heavy
@pytest.mark.parametrize("quality", [70, 80, 90, 95, 100])
@pytest.mark.parametrize("seed", [0, 5])
def test_sensor_at_rest_is_not_frozen(seed: int, quality: int) -> None:
    assert not any(states(list(islice(live(seed, quality), 150))))


@pytest.mark.parametrize("every_ns", [0, SELDOM_NS])
@pytest.mark.parametrize("repeats", [2, 6, 12])
def test_video_converted_to_a_higher_rate_is_not_frozen(repeats: int, every_ns: int) -> None:
    slower = islice(live(1), 240 // repeats)
    assert not any(states([image for image in slower for _ in range(repeats)], every_ns=every_ns))


def test_few_pictures_of_a_live_source_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = []
    inner = PictureNews._compare
    monkeypatch.setattr(PictureNews, "_compare", lambda *of: compared.append(of) or inner(*of))
    states(list(islice(live(0), 300)), every_ns=SELDOM_NS)
    assert len(compared) <= LEARNT_PICTURES + 1 + 5 * NS_PER_S / SELDOM_NS, "5 s at 60 Hz"


def test_few_frames_per_second_need_several_repeats() -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (320, 240, 3), dtype=np.uint8) for _ in range(3)]
    once = [image for image in pictures for _ in range(2)]
    assert not any(states(once, FROZEN_NS * 2))
    assert states([pictures[0]] * 5, FROZEN_NS * 2) == [number >= FROZEN_REPEATS for number in range(5)]


@pytest.mark.heavy
def test_dimmed_sensor_with_less_noise_is_not_frozen() -> None:
    rng = np.random.default_rng(0)

    def picture(light: float) -> Image:
        noise = rng.normal(0.0, 1.5 * light, (320, 240, 3))
        return np.clip(np.rint(light * 120.0 + noise), 0, 255).astype(np.uint8)

    assert not any(states([picture(1.0) for _ in range(60)] + [picture(0.4) for _ in range(120)]))


def test_turning_contact_without_noise_is_not_frozen() -> None:
    def bar(angle_deg: float) -> Image:
        image = np.full((320, 240, 3), 90, np.uint8)
        box = cv2.boxPoints(((120.0, 160.0), (140.0, 20.0), angle_deg))
        cv2.fillConvexPoly(image, np.rint(box * 16).astype(np.int32), (140, 120, 60), shift=4)
        return image

    assert not any(states([bar(0.3 * number) for number in range(120)]))


class Played:
    """A source with these pictures, 60 per second."""

    serial = "PLAYED"

    def __init__(self, pictures: list[Image]) -> None:
        self._frames = (Frame(image, i * PERIOD_NS, i, self.serial) for i, image in enumerate(pictures))

    def next_frame(self, timeout_s: float) -> Frame:
        return next(self._frames)

    newest_frame = next_frame


def test_copies_are_left_out_of_new_pictures() -> None:
    a, b, c = islice(live(2), 3)
    frames = islice(new_pictures(Played([a, a, a, b, b, one_pixel(b, 1), c]), 1.0, 1.0), 2)
    assert [frame.sequence for frame in frames] == [3, 6]


@pytest.mark.parametrize("live_pictures", [1, 20])
def test_new_pictures_of_a_frozen_source_end_with_an_error(live_pictures: int) -> None:
    pictures = list(islice(live(2), live_pictures))
    frames = new_pictures(Played(pictures + pictures[-1:] * 40), 1.0, 1.0)
    assert len(list(islice(frames, live_pictures - 1))) == live_pictures - 1
    with pytest.raises(StaleFrameError, match="PLAYED: it has repeated its picture"):
        next(frames)


def test_pictures_of_another_size_are_new() -> None:
    news = PictureNews()
    for number, (height, width) in enumerate([(64, 64), (64, 32), (128, 128), (64, 64), (64, 32)]):
        news.add(np.full((height, width, 3), 7, np.uint8), number * PERIOD_NS)
        assert news.repeated is (number > 1)
