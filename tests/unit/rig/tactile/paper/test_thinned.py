"""Thinning of a cropped mask gives what OpenCV gives for the whole picture."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.tactile.paper.axis import thinned


def reference(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.ximgproc.thinning(mask, thinningType=cv2.ximgproc.THINNING_GUOHALL))


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(st.floats(-20, 276), st.floats(-20, 340)),
    st.tuples(st.floats(1, 240), st.floats(1, 120)),
    st.floats(0, 180),
)
def test_ellipses_thin_as_in_opencv_even_across_the_border(
    center: tuple[float, float], axes: tuple[float, float], angle_deg: float
) -> None:
    mask = np.zeros((320, 256), np.uint8)
    cv2.ellipse(mask, (center, axes, angle_deg), 255, -1)
    assert np.array_equal(thinned(mask), reference(mask))


def test_empty_mask_stays_empty() -> None:
    assert not thinned(np.zeros((20, 30), np.uint8)).any()
