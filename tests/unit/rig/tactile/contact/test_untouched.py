"""Frames of the untouched gel are found in a recording, and frames with contact are not."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.frames.series import evenly_spread, find_background
from rig.tactile.contact.untouched import LEAST_FRAMES, OPENING_FRAMES, still_opening

Image = NDArray[np.uint8]
Draw = Callable[..., Image]


@pytest.fixture
def rest(press: Draw) -> Callable[[int], list[Image]]:
    return lambda count: [press(None, seed=i) for i in range(count)]


@pytest.fixture
def turning(press: Draw) -> Callable[[int], list[Image]]:
    """A contact that turns by 2 degrees from frame to frame and stays in its place."""
    return lambda count: [press(10 + 2 * i, (85, 25), seed=100 + i) for i in range(count)]


def found(frames: list[Image]) -> tuple[Image, str]:
    return find_background("clip", frames, evenly_spread(frames))


def error(made: Image, blank: Image) -> float:
    return float(np.abs(made.astype(float) - blank).mean())


def test_still_opening_before_a_contact_is_the_background(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]], blank: Image
) -> None:
    background, note = found([*rest(12), *turning(40)])
    assert error(background, blank) < 1.5
    assert "first 7 frames" in note


def test_recording_that_begins_in_contact_uses_its_most_frequent_image(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]], blank: Image
) -> None:
    background, note = found([*turning(12), *rest(20)])
    assert error(background, blank) < 1.5
    assert "most alike" in note


def test_still_contact_at_the_start_is_not_the_background(
    press: Draw, rest: Callable[[int], list[Image]], blank: Image
) -> None:
    still = [press(20, (85, 25), seed=200 + i) for i in range(10)]
    background, _ = found([*still, *rest(20)])
    assert error(background, blank) < 1.5


@pytest.mark.parametrize("kind", ["contact throughout", "untouched throughout", "too few"])
def test_recording_without_a_recognisable_untouched_gel_is_refused(
    kind: str, rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]]
) -> None:
    frames = {"contact throughout": turning(30), "untouched throughout": rest(30), "too few": turning(2)}[
        kind
    ]
    with pytest.raises(InputError, match="--background"):
        found(frames)


def test_opening_leaves_out_the_onset_and_is_bounded(
    rest: Callable[[int], list[Image]], turning: Callable[[int], list[Image]]
) -> None:
    assert len(still_opening([*rest(100)])) == OPENING_FRAMES
    assert len(still_opening([*rest(20), *turning(3)])) == 15
    assert len(still_opening([*rest(5), *turning(3)])) == LEAST_FRAMES
    assert still_opening(turning(10)) == []


def test_frames_of_one_colour_give_a_typed_error() -> None:
    black, white = np.zeros((320, 240, 3), np.uint8), np.full((320, 240, 3), 255, np.uint8)
    for frames in ([black] * 20, [white] * 20, [black] * 10 + [white] * 10):
        with pytest.raises(InputError, match="--background"):
            found(frames)
