"""The frame without contact, made from frames with contacts."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.contact.background import auto_background, mean_background

Image = NDArray[np.uint8]
Draw = Callable[..., Image]

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
