"""Specks of the gel are found in the background and removed from frames."""

import cv2
import numpy as np
import pytest

from rig.tactile.contact.gel_marks import MOST_SHARE, GelMarks, found_marks
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
    mended = GelMarks(found_marks(background, FINE), FINE).mended(spoilt)
    assert mended[marked] == pytest.approx(slope[marked], abs=2e-3)
    np.testing.assert_array_equal(mended[~marked], slope[~marked])


def test_gel_without_marks_is_unchanged() -> None:
    difference = np.zeros((FINE[1], FINE[0], 3), np.float32)
    assert GelMarks(found_marks(drawn_press(None), FINE), FINE).mended(difference) is difference
