"""Whatever a frame is: an answer that can be true, or an `InputError` that names what was given."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.contact.relative import full_area, work_size
from rig.tactile.estimators import ESTIMATORS, TOSKOV, choose_estimator
from rig.tactile.sample import MAX_SIDE_PX, MOST_ELONGATED, SlipSample, State

Image = NDArray[np.uint8]
STEP_NS = 16_666_667
NAMES = [name for name in ESTIMATORS if name != TOSKOV]
"""Toskov's network asks for the arm's states too."""
SIZES = [(8, 8), (9, 8), (13, 17), (8, 320), (320, 9), (41, 1601), (240, 320), (241, 319), (333, 250)]


def gel(height: int, width: int, seed: int = 0) -> Image:
    """Light that varies over the gel, and noise."""
    y, x = np.mgrid[0 : 1 : complex(0, height), 0 : 1 : complex(0, width)]
    light = np.stack([170 - 130 * x, 40 + 110 * x * y, 120 - 70 * y], axis=-1)
    return np.clip(light + np.random.default_rng(seed).normal(0, 1.5, light.shape), 0, 255).astype(np.uint8)


def touched(height: int, width: int, share: float, seed: int) -> Image:
    """The gel under a block with a rough surface that covers a share of each side."""
    frame = gel(height, width, seed)
    rows, columns = (slice(0, max(1, round(side * share))) for side in (height, width))
    rough = np.random.default_rng(5).integers(0, 256, (1 + height // 8, 1 + width // 8, 3), dtype=np.uint8)
    frame[rows, columns] = cv2.resize(rough, (width, height), interpolation=cv2.INTER_CUBIC)[rows, columns]
    return frame


def check(sample: SlipSample, frame: Image) -> None:
    """What is told can be true."""
    assert 0.0 <= sample.contact_area_px <= frame.shape[0] * frame.shape[1]
    told = [sample.angle_deg, sample.sigma_deg, sample.rate_deg_s, *(sample.shift_px or ())]
    assert all(value is None or math.isfinite(value) for value in told)
    if sample.state is State.NO_CONTACT:
        assert sample.angle_deg is None
        assert sample.contact_area_px == 0.0


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("name", NAMES)
def test_any_size_gets_an_answer_that_can_be_true(name: str, size: tuple[int, int]) -> None:
    estimator = choose_estimator(name).make(gel(*size))
    for i, share in enumerate((0.0, 0.3, 0.6, 0.6, 1.0, 1.0, 0.0)):
        frame = touched(*size, share, i) if share else gel(*size, i + 1)
        check(estimator.update(frame, i * STEP_NS), frame)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    size=st.tuples(st.integers(8, 200), st.integers(8, 200)),
    share=st.floats(0.1, 1.0),
    name=st.sampled_from(["slip", "ellipse", "ellipse-published", "ecc", "polar", "kolamuri"]),
)
def test_no_contact_is_larger_than_the_frame(size: tuple[int, int], share: float, name: str) -> None:
    estimator = choose_estimator(name).make(gel(*size))
    for i in range(3):
        frame = touched(*size, share, i)
        check(estimator.update(frame, i * STEP_NS), frame)


@given(height=st.integers(8, MAX_SIDE_PX), width=st.integers(8, MAX_SIDE_PX), aspect=st.floats(0.5, 2.0))
def test_the_reduced_copy_is_never_empty_and_its_area_never_more_than_the_frame(
    height: int, width: int, aspect: float
) -> None:
    if max(height, width) > MOST_ELONGATED * min(height, width):
        return
    columns, rows = work_size((height, width, 3), aspect)
    assert columns >= 1
    assert rows >= 1
    assert full_area(columns * rows, (rows, columns), (height, width)) <= height * width


REFUSED: list[NDArray[np.generic]] = [
    np.zeros((1, 1, 3), np.uint8), np.zeros((0, 0, 3), np.uint8), np.zeros((7, 320, 3), np.uint8),
    np.zeros((8000, 8, 3), np.uint8), np.zeros((8, 400, 3), np.uint8), np.zeros((240, 320), np.uint8),
    np.zeros((240, 320, 4), np.uint8), np.zeros((240, 320, 3), np.float32),
    np.zeros((240, 320, 3), np.uint16),
]  # fmt: skip


@pytest.mark.parametrize("image", REFUSED, ids=lambda image: f"{image.shape} {image.dtype}")
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_tactile_frame_is_refused(name: str, image: Image) -> None:
    with pytest.raises(InputError, match="tactile frame has"):
        choose_estimator(name).make(image)
    estimator = choose_estimator(name).make(gel(240, 320))
    with pytest.raises(InputError, match="tactile frame has"):
        estimator.update(image, 0)


@pytest.mark.parametrize("name", NAMES)
def test_a_size_that_changes_is_refused_and_the_rest_answered(name: str) -> None:
    estimator: Callable = choose_estimator(name).make(gel(240, 320)).update
    estimator(gel(240, 320, 1), 0)
    with pytest.raises(InputError, match="use one size"):
        estimator(gel(120, 160), STEP_NS)
    check(estimator(touched(240, 320, 0.5, 2), 2 * STEP_NS), gel(240, 320))


def test_the_largest_frames_are_looked_at_small() -> None:
    largest = gel(1024, MAX_SIDE_PX)
    for name in ("slip", "ellipse", "kolamuri"):
        check(choose_estimator(name).make(largest).update(largest, 0), largest)
