"""Backgrounds: found in a recording, doubtful with a contact in them, and taken at the start of a clip."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.images import read_image
from fakes.gel.sensor import GelSensor
from rig.frames.estimates import CHECKED_FRAMES
from rig.frames.series import evenly_spread, find_background
from rig.tactile.contact.background import auto_background, mean_background
from rig.tactile.contact.background_check import BackgroundCheck, gel_change
from rig.tactile.contact.untouched import LEAST_FRAMES, OPENING_FRAMES, still_opening
from support.desk_frames import desk_frames

STEP_NS = NS_PER_S // 25
Image = NDArray[np.uint8]
Draw = Callable[..., Image]


def doubted(background: Image, frames: Iterable[Image]) -> bool:
    check = BackgroundCheck(background)
    for place, image in evenly_spread(enumerate(frames), CHECKED_FRAMES):
        check.check(image, place * STEP_NS)
    return bool(check.doubt)


@pytest.fixture(scope="module")
def desk() -> list[Image]:
    """Frames of a simulated press, 5 per second: 3 s without contact, both turns, the gel afterwards."""
    return [frame.image for frame in desk_frames(18.0, -1, 0.0, every=6)]


@pytest.mark.heavy
def test_background_without_contact_is_not_doubted_during_a_press(desk: list[Image]) -> None:
    assert not doubted(mean_background(desk[:4]), desk)


@pytest.mark.parametrize("place", [20, 40, 70])
def test_background_with_a_clear_contact_is_doubted_without_other_frames(
    desk: list[Image], place: int
) -> None:
    assert doubted(desk[place], [])


def test_background_with_a_weak_contact_is_doubted_after_release_but_not_by_one_odd_frame(
    press: Draw,
) -> None:
    weak = press(20, (85, 25), seed=3, strength=0.3)
    assert not doubted(weak, [])
    assert doubted(weak, [press(None, seed=10 + i) for i in range(5)])
    assert not doubted(weak, [press(20, (85, 25), seed=4, strength=0.3), press(None, seed=10), weak])


def test_dirty_gel_is_trusted_after_a_press(press: Draw) -> None:
    """A speck of dirt has edges as a contact has, but a contact has stronger ones, and the dirt stays."""
    rng = np.random.default_rng(1)
    dirt = np.ones((320, 240, 1))
    for y, x in rng.integers(30, 200, (9, 2)):
        dirt[y : y + 14, x : x + 14] = 0.5

    def dirty(image: Image) -> Image:
        return (image * dirt).astype(np.uint8)

    background = dirty(press(None, seed=0))
    assert doubted(background, [])
    assert not doubted(background, [dirty(press(10 + i, (85, 25), seed=i)) for i in range(5)])


@pytest.mark.heavy
@pytest.mark.parametrize("markers", [False, True])
def test_simulated_units_without_contact_are_not_doubted_while_their_light_drifts(markers: bool) -> None:
    rng = np.random.default_rng(0)
    for unit in range(0, 40, 10):
        gel = GelSensor(unit, markers=markers)
        assert not doubted(
            gel.render(None, 0.0, rng), [gel.render(None, 20.0 * i, rng) for i in range(10)]
        ), unit


def test_change_of_the_gel_is_named_with_its_light(press: Draw) -> None:
    before, now = press(None, seed=0), press(None, seed=1, light=(0.9, 0.9, 0.9))
    change = gel_change(before, now)
    assert change.contact is None
    assert change.light == pytest.approx(-0.1, abs=0.01)
    assert change.text.startswith("light -10 %, gel ")
    touched = press(20, (85, 25), seed=2)
    assert gel_change(before, touched).contact == "now"
    assert gel_change(touched, before).contact == "before"


def clips(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob("*/background.png"))


def real_doubts(clip: Path) -> tuple[bool, bool]:
    """Whether a clip's own background is doubted, and a frame with contact as its background."""
    frames = [read_image(file) for file in sorted((clip / "frames").iterdir())]
    return doubted(read_image(clip / "background.png"), frames), doubted(frames[len(frames) // 2], frames)


def test_backgrounds_of_real_clips_are_not_doubted(real_clips: Path) -> None:
    found = [real_doubts(clip) for clip in clips(real_clips)]
    assert [own for own, _ in found] == [False] * len(found)
    assert sum(other for _, other in found) >= 0.6 * len(found), "soft contacts have no edges"


def test_backgrounds_of_real_turns_are_not_doubted() -> None:
    folder = Path(os.environ.get("RIG_REAL_TURNS", ""))
    if not (folder / "pk_133601").is_dir():
        pytest.skip("RIG_REAL_TURNS does not name the folder that real_turns/make.py makes")
    found = {clip.name: real_doubts(clip) for clip in clips(folder)}
    assert not any(own for own, _ in found.values())
    without_edges, always_in_contact = "pk_consecutive", "slip_screwdriver4_c0"
    assert {name for name, (_, other) in found.items() if not other} == {without_edges, always_in_contact}


@pytest.mark.parametrize("variable", ["gelsight_ball", "RIG_DIGIT_BALLS"])
def test_backgrounds_of_real_balls_are_not_doubted(variable: str, real_data: Path) -> None:
    folder = real_data / variable if variable.islower() else Path(os.environ.get(variable, "")) / "frames"
    if not folder.is_dir():
        pytest.skip("RIG_DIGIT_BALLS does not name the folder that digit_balls/rebuild.py makes")
    background = folder / "background.png" if variable.islower() else folder.parent / "background.png"
    balls = [read_image(file) for file in sorted(folder.glob("*_*.png" if variable.islower() else "*.png"))]
    assert not doubted(read_image(background), balls)
    assert doubted(balls[0], [read_image(background)] * 3)


PLACES = [
    (70, 90),
    (160, 90),
    (120, 160),
    (70, 230),
    (170, 240),
    (120, 70),
    (60, 160),
    (180, 160),
    (120, 250),
]


def error(background: Image, truth: Image) -> float:
    return float(np.abs(background.astype(int) - truth).mean())


def test_moving_contacts_are_absent_from_the_background(press: Draw, blank: Image) -> None:
    frames = [press(20 * i, (60.0, 25.0), center, seed=i) for i, center in enumerate(PLACES)]
    made = auto_background(frames)
    assert made.dtype == np.uint8
    assert error(made, blank) < 1.5
    assert error(np.median(frames, axis=0), blank) > error(made, blank)


@pytest.mark.heavy
def test_few_frames_without_contact_are_found_among_many(press: Draw, blank: Image) -> None:
    frames = [press(None, seed=i) for i in range(4)] + [press(0.3 * i, seed=i) for i in range(40)]
    assert error(auto_background(frames), blank) < 2.0
    assert error(np.median(frames, axis=0), blank) > 4.0


def test_background_is_complete_even_if_a_pixel_is_always_in_contact(press: Draw) -> None:
    frames = [press(0, seed=i) for i in range(5)]
    assert auto_background(frames).shape == (320, 240, 3)


@pytest.mark.parametrize("make", [auto_background, mean_background])
def test_too_few_or_mixed_frames_are_input_errors(make: Callable[[list[Image]], Image], blank: Image) -> None:
    with pytest.raises(InputError, match="too few"):
        make([])
    with pytest.raises(InputError, match="use one size"):
        make([blank, blank, blank[:100]])


@pytest.fixture
def rest(press: Draw) -> Callable[[int], list[Image]]:
    return lambda count: [press(None, seed=i) for i in range(count)]


@pytest.fixture
def turning(press: Draw) -> Callable[[int], list[Image]]:
    """A contact that turns by 2 degrees from frame to frame and stays in its place."""
    return lambda count: [press(10 + 2 * i, (85, 25), seed=100 + i) for i in range(count)]


def found(frames: list[Image]) -> tuple[Image, str]:
    return find_background("clip", frames, evenly_spread(frames))


def off_grey(made: Image, blank: Image) -> float:
    return float(np.abs(made.astype(float) - blank).mean())


@pytest.mark.heavy
def test_still_opening_before_a_contact_is_the_background(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]], blank: Image
) -> None:
    background, note = found([*rest(12), *turning(40)])
    assert off_grey(background, blank) < 1.5
    assert "first 7 frames" in note


@pytest.mark.heavy
def test_recording_that_begins_in_contact_uses_its_most_frequent_image(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]], blank: Image
) -> None:
    background, note = found([*turning(12), *rest(20)])
    assert off_grey(background, blank) < 1.5
    assert "most alike" in note


@pytest.mark.heavy
def test_still_contact_at_the_start_is_not_the_background(
    press: Draw, rest: Callable[[int], list[Image]], blank: Image
) -> None:
    still = [press(20, (85, 25), seed=200 + i) for i in range(10)]
    background, _ = found([*still, *rest(20)])
    assert off_grey(background, blank) < 1.5


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["contact throughout", "untouched throughout", "too few"])
def test_recording_without_a_recognisable_untouched_gel_is_refused(
    kind: str, rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]]
) -> None:
    frames = {"contact throughout": turning(30), "untouched throughout": rest(30), "too few": turning(2)}[
        kind
    ]
    with pytest.raises(InputError, match="--background"):
        found(frames)


@pytest.mark.heavy
def test_opening_leaves_out_the_onset_and_is_bounded(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]]
) -> None:
    assert len(still_opening([*rest(100)])) == OPENING_FRAMES
    assert len(still_opening([*rest(20), *turning(3)])) == 15
    assert len(still_opening([*rest(5), *turning(3)])) == LEAST_FRAMES
    assert still_opening(turning(10)) == []


@pytest.mark.heavy
def test_frames_of_one_colour_give_a_typed_error() -> None:
    black, white = np.zeros((320, 240, 3), np.uint8), np.full((320, 240, 3), 255, np.uint8)
    for frames in ([black] * 20, [white] * 20, [black] * 10 + [white] * 10):
        with pytest.raises(InputError, match="--background"):
            found(frames)
