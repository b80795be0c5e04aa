"""Whether the pictures of a stream are new: copies of one picture, in any encoding, and pictures at rest."""

from collections.abc import Callable, Iterator
from itertools import islice

import cv2
import numpy as np
import pytest

from drivers.errors import StaleFrameError
from drivers.tally import FROZEN_NS, FROZEN_REPEATS, PictureNews, new_pictures
from drivers.types import Frame, Image
from fakes.gel.sensor import GelSensor

PERIOD_NS = 1_000_000_000 // 60
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


def states(pictures: list[Image], period_ns: int = PERIOD_NS) -> list[bool]:
    news, found = PictureNews(), []
    for number, image in enumerate(pictures):
        news.add(image, number * period_ns)
        found.append(news.frozen)
    return found


@pytest.mark.parametrize("name", COPIES)
def test_copies_are_frozen_after_the_limit_until_pictures_change(name: str) -> None:
    source = live(3)
    before = [next(source) for _ in range(LIVE)]
    copies = [COPIES[name](before[-1], number) for number in range(90)]
    found = states(before + copies + [next(source) for _ in range(LIVE)])
    assert not any(found[:LIVE])
    late = FROZEN_NS // PERIOD_NS + 2
    assert all(found[LIVE + late : LIVE + 90])
    assert not any(found[LIVE : LIVE + late - 4])
    assert not any(found[LIVE + 90 :]), "live again"


@pytest.mark.parametrize("quality", [70, 80, 90, 95, 100])
@pytest.mark.parametrize("seed", [0, 5])
def test_sensor_at_rest_is_not_frozen(seed: int, quality: int) -> None:
    source = live(seed, quality)
    assert not any(states([next(source) for _ in range(150)]))


@pytest.mark.parametrize("repeats", [2, 6, 12])
def test_video_converted_to_a_higher_rate_is_not_frozen(repeats: int) -> None:
    source = live(1)
    slower = [next(source) for _ in range(240 // repeats)]
    assert not any(states([image for image in slower for _ in range(repeats)]))


def test_few_frames_per_second_need_several_repeats() -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (320, 240, 3), dtype=np.uint8) for _ in range(3)]
    once = [image for image in pictures for _ in range(2)]
    assert not any(states(once, FROZEN_NS * 2))
    assert states([pictures[0]] * 5, FROZEN_NS * 2) == [number >= FROZEN_REPEATS for number in range(5)]


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
    for number in range(100):
        side = 64 if number % 2 else 128
        news.add(np.full((side, side, 3), 7, np.uint8), number * PERIOD_NS)
        if number > 1:
            assert news.repeated
    news = PictureNews()
    news.add(np.full((64, 64, 3), 7, np.uint8), 0)
    news.add(np.full((64, 32, 3), 7, np.uint8), PERIOD_NS)
    assert not news.repeated
