"""Marks of the gel, also later ones, and saturated pixels are no contact and do not disturb the angle."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from drivers.clock import NS_PER_S
from drivers.types import Frame, Image
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.gate import find_contact
from rig.tactile.contact.gel_marks import MOST_SHARE, GelMarks, found_marks
from rig.tactile.contact.later_marks import SEARCH_NS, LaterMarks, Verdict
from rig.tactile.contact.relative import RelativeDifference, work_size
from rig.tactile.estimators import choose_estimator
from support.desk_frames import desk_digit, desk_frames
from support.drawn_sensor import SPECKS, drawn_press, specked

FINE = (120, 160)


def test_only_true_specks_are_found() -> None:
    marked = found_marks(specked(drawn_press(None), 0.25), FINE)
    centers = {(round(x), round(y)) for x, y in cv2.connectedComponentsWithStats(marked)[3][1:]}
    assert centers == {(x // 2, y // 2) for x, y in SPECKS}
    assert not found_marks(drawn_press(None), FINE).any()


def test_patterned_gel_has_no_marks() -> None:
    dots = drawn_press(None)
    for x in range(10, 240, 20):
        for y in range(10, 320, 20):
            cv2.circle(dots, (x, y), 4, (10, 10, 10), -1)
    assert not found_marks(dots, FINE).any()
    assert MOST_SHARE < 0.2


def test_marks_are_filled_and_other_pixels_unchanged() -> None:
    background = specked(drawn_press(None), 0.25)
    slope = np.repeat(np.linspace(0, 1, FINE[0], dtype=np.float32)[None, :, None], FINE[1], 0).repeat(3, 2)
    spoilt, marked = slope.copy(), found_marks(background, FINE) > 0
    spoilt[marked] = 9.0
    mended = GelMarks(found_marks(background, FINE), FINE).fill(spoilt)
    assert mended[marked] == pytest.approx(slope[marked], abs=2e-3)
    np.testing.assert_array_equal(mended[~marked], slope[~marked])


def test_gel_without_marks_is_unchanged() -> None:
    difference = np.zeros((FINE[1], FINE[0], 3), np.float32)
    assert GelMarks(found_marks(drawn_press(None), FINE), FINE).fill(difference) is difference


TOUCH_S, TURNED_S = 3.0, 8.0
Pattern = Callable[[Image], Image]


def hair(image: Image) -> Image:
    """A dark hair across the picture."""
    points = np.array([(40 + 4 * i, 160 + round(60 * np.sin(i / 12.0))) for i in range(40)], np.int32)
    return drawn_over(image, [points], 0.0, 0.6, 2)


def scratches(image: Image) -> Image:
    """Three bright scratches."""
    ends = (((30, 60), (150, 130)), ((200, 90), (110, 240)), ((60, 260), (190, 200)))
    return drawn_over(image, [np.array(pair, np.int32) for pair in ends], 255.0, 0.35, 2)


def dust(image: Image) -> Image:
    """Dark specks."""
    spots = [np.array([(x, y), (x + 4, y + 2)], np.int32) for x, y in SPECKS]
    return drawn_over(image, spots, 0.0, 0.6, 4)


def drawn_over(image: Image, lines: list[np.ndarray], grey: float, opacity: float, width: int) -> Image:
    cover = np.zeros(image.shape[:2], np.uint8)
    cv2.polylines(cover, lines, False, 255, width, cv2.LINE_AA)
    share = opacity * cover[..., None] / 255.0
    return np.rint((1.0 - share) * image + share * grey).astype(np.uint8)


def pixels(image: Image) -> Image:
    """Single pixels that are always white."""
    copy, rng = image.copy(), np.random.default_rng(3)
    copy[rng.integers(60, 260, 20), rng.integers(60, 180, 20)] = 255
    return copy


@pytest.fixture(scope="module")
def desk() -> list[Frame]:
    """Frames of a simulated press, 15 per second: 1 s without contact, then a touch and a turn."""
    return list(desk_frames(TURNED_S, every=2))


def background_of(desk: list[Frame]) -> Image:
    return mean_background([frame.image for frame in desk[:8]])


@pytest.mark.heavy
@pytest.mark.parametrize("pattern", [hair, scratches, dust, pixels])
def test_marks_that_came_after_the_background_are_left_out(desk: list[Frame], pattern: Pattern) -> None:
    estimator = choose_estimator("slip").make(background_of(desk))
    samples = [estimator.update(pattern(frame.image), frame.time_ns) for frame in desk]
    assert {sample.state for sample in samples if sample.time_ns < 2.95 * NS_PER_S} == {"no_contact"}
    zero = next(sample for sample in samples if sample.settled and sample.angle_deg is not None)
    digit, last = desk_digit(), samples[-1]
    digit.draw(0, np.random.default_rng(0))
    turned = [digit.turn_deg(sample.time_ns) for sample in (zero, last)]
    assert last.angle_deg - zero.angle_deg == pytest.approx(turned[1] - turned[0], abs=1.5)


@pytest.mark.heavy
@pytest.mark.parametrize("ends", [((60, 64), (120, 256)), ((170, 90), (160, 260)), ((40, 200), (200, 170))])
def test_straight_scratch_looks_like_a_contact_until_one_comes(
    desk: list[Frame], ends: tuple[tuple[int, int], tuple[int, int]]
) -> None:
    """It could be a blade that was in the hand before; the contact beside it shows that it is a mark."""
    scratch = [np.array(ends, np.int32)]
    estimator = choose_estimator("slip").make(background_of(desk))
    pictures = [(drawn_over(frame.image, scratch, 20.0, 1.0, 2), frame.time_ns) for frame in desk]
    samples = [estimator.update(*picture) for picture in pictures]
    zero = next(s for s in samples if s.time_ns > 4.0 * NS_PER_S and s.settled and s.angle_deg is not None)
    digit, last = desk_digit(), samples[-1]
    digit.draw(0, np.random.default_rng(0))
    turned = [digit.turn_deg(sample.time_ns) for sample in (zero, last)]
    error_deg = last.angle_deg - zero.angle_deg - (turned[1] - turned[0])
    assert abs(error_deg) < max(1.5, 2.0 * last.sigma_deg)
    assert last.sigma_deg < 5.0


@pytest.mark.heavy
def test_what_an_object_leaves_on_the_gel_is_no_contact() -> None:
    background, step_ns = drawn_press(None), NS_PER_S // 20
    estimator = choose_estimator("slip").make(background)
    pictures = [drawn_press(None, seed=n) for n in range(10)] + [drawn_press(n, seed=n) for n in range(20)]
    left = [hair(drawn_press(None, seed=n)) for n in range(100, 130)]
    states = [estimator.update(one, n * step_ns).state for n, one in enumerate([*pictures, *left])]
    assert set(states[12:30]) <= {"tracking", "rekeyed"}
    assert set(states[42:]) == {"no_contact"}


def difference(image: Image, background: Image) -> np.ndarray:
    light = RelativeDifference(background, FINE)
    return light.of(light.reduce(image))


def judge(marks: LaterMarks, image: Image, background: Image, time_ns: int) -> Verdict:
    """Judge a frame as the estimator does, whose first work copy has no marks filled."""
    light = RelativeDifference(background, (60, 80))
    region = find_contact(light.of(light.reduce(image)))
    return marks.judge(lambda: difference(image, background), region, time_ns)


def test_later_marks_are_found_and_forgotten_when_wiped_off() -> None:
    background = drawn_press(None)
    marks, dirty = LaterMarks(found_marks(background, FINE)), specked(background, 0.4)
    verdicts = [judge(marks, dirty, background, n * SEARCH_NS) for n in range(4)]
    assert verdicts == [Verdict(False, is_news=n == 1) for n in range(4)]
    centers = {(round(x), round(y)) for x, y in cv2.connectedComponentsWithStats(marks.marked)[3][1:]}
    assert centers == {(x // 2, y // 2) for x, y in SPECKS}
    for n in range(4, 44):
        judge(marks, background, background, n * SEARCH_NS)
    assert not marks.marked.any()


def test_frames_beside_a_contact_are_not_searched() -> None:
    """It may be faintly visible in them, with edges that look like marks."""
    background = drawn_press(None)
    faint = difference(specked(background, 0.4), background)

    def is_news(*between: Image) -> bool:
        marks = LaterMarks(found_marks(background, FINE))
        marks.judge(lambda: faint, None, 0)
        for image in between:
            assert judge(marks, image, background, SEARCH_NS).is_contact
        return marks.judge(lambda: faint, None, 2 * SEARCH_NS).is_news

    assert is_news()
    assert not is_news(drawn_press(20.0))


@pytest.mark.parametrize("rate_hz", [3.0, 60.0])
def test_small_contact_that_grows_is_no_mark(rate_hz: float) -> None:
    """Its marks cover it at first, as they do with a scratch; but a scratch keeps its area."""
    background = drawn_press(None)
    marks = LaterMarks(found_marks(background, FINE))
    sizes = ((24.0, 7.5), (30.0, 9.0), (36.0, 11.0), (46.0, 14.0), (56.0, 17.5), (56.0, 17.5))
    verdicts = [
        judge(marks, drawn_press(20.0, size, strength=0.7), background, round(n * NS_PER_S / rate_hz))
        for n, size in enumerate(sizes)
    ]
    assert verdicts == [Verdict(True)] * len(sizes)


def test_contact_is_not_explained_by_marks() -> None:
    background = drawn_press(None)

    def shows_contact(image: Image) -> bool:
        return judge(LaterMarks(found_marks(background, FINE)), image, background, 0).is_contact

    assert not shows_contact(specked(background, 0.4))
    assert not shows_contact(hair(background))
    assert shows_contact(specked(drawn_press(20.0), 0.4))
    for half_axes in ((56.0, 17.5), (36.0, 11.0), (24.0, 7.5)):
        assert shows_contact(drawn_press(20.0, half_axes, strength=0.7))


def test_saturated_pixels_are_no_contact() -> None:
    background = cv2.convertScaleAbs(drawn_press(None), alpha=1.6)
    dark = np.asarray(background // 2, np.uint8)
    dark[100:220, 60:180] = 160
    light = RelativeDifference(dark, work_size(dark.shape, 1.0))
    bright = np.clip(2.0 * dark.astype(np.float32), 0, 255).astype(np.uint8)
    assert find_contact(light.of(light.reduce(bright))) is None
