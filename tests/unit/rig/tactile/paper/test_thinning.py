"""Thinning is OpenCV's Guo-Hall, bit for bit."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.paper.thinning import thin

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=3, max_side=40)


def reference(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.ximgproc.thinning(mask, thinningType=cv2.ximgproc.THINNING_GUOHALL))


@given(hnp.arrays(np.uint8, SHAPES, elements=st.sampled_from([0, 255]), fill=st.just(0)))
def test_sparse_pictures_thin_as_in_opencv(mask: NDArray[np.uint8]) -> None:
    assert np.array_equal(thin(mask), reference(mask))


@given(SHAPES, st.integers(0, 2**32 - 1), st.floats(0.05, 0.95), st.floats(0.3, 4.0))
def test_noise_and_blobs_thin_as_in_opencv(
    shape: tuple[int, ...], seed: int, filled: float, blur_px: float
) -> None:
    noise = np.random.default_rng(seed).random(shape, np.float32)
    field = cv2.GaussianBlur(noise, (0, 0), blur_px)
    mask = np.where(field > np.quantile(field, 1 - filled), 255, 0).astype(np.uint8)
    assert np.array_equal(thin(mask), reference(mask))


@settings(max_examples=30)
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
    assert np.array_equal(thin(mask), reference(mask))


@given(hnp.arrays(np.uint8, (12, 17)))
def test_grey_values_count_from_the_level_opencv_counts_them(mask: NDArray[np.uint8]) -> None:
    assert np.array_equal(thin(mask), reference(mask))


def test_the_input_stays_as_it_was() -> None:
    mask = np.zeros((20, 20), np.uint8)
    mask[4:12, 3:18] = 255
    mask.setflags(write=False)
    assert 0 < thin(mask[::-1].T).sum() < mask.sum()


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (2, 9), (0, 5)])
def test_pictures_that_are_all_border_stay(shape: tuple[int, int]) -> None:
    mask = np.full(shape, 255, np.uint8)
    assert np.array_equal(thin(mask), mask)


@pytest.mark.parametrize("mask", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4)), np.zeros(4, np.uint8)])
def test_anything_but_a_mask_is_refused(mask: NDArray[np.uint8]) -> None:
    with pytest.raises(InputError, match="thinning takes"):
        thin(mask)
