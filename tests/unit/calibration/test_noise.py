"""The noise of a camera's frames, measured in frames and drawn again."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.gel.noise import measure_noise

SHAPE = (160, 120)
PAIR_SIGMA = 2.0


def _frames_with_shared_colour(count: int) -> list[NDArray[np.floating]]:
    """Brightness noise of each pixel, and red noise that two rows share, as of cameras with 4:2:0 colour."""
    rng, frames = np.random.default_rng(3), []
    for _ in range(count):
        frame = np.repeat(rng.normal(0.0, 1.0, (*SHAPE, 1)), 3, axis=2)
        frame[..., 0] += np.repeat(rng.normal(0.0, PAIR_SIGMA, (SHAPE[0] // 2, SHAPE[1])), 2, axis=0)
        frames.append(np.rint(frame))
    return frames


def test_drawn_noise_has_the_colours_and_the_row_pairs_of_the_frames() -> None:
    frames = _frames_with_shared_colour(6)
    noise = measure_noise(frames, [np.ones(SHAPE, bool)] * 6)
    drawn = noise.draw(SHAPE, 4, np.random.default_rng(0))
    assert drawn.std((0, 1, 2)) == pytest.approx(noise.sigma_grey, rel=0.03)
    assert noise.sigma_grey == pytest.approx([5.0**0.5, 1.0, 1.0], rel=0.03)
    red = drawn[..., 0] - drawn[..., 1]
    within_pairs, across_pairs = (np.abs(np.diff(red, axis=1))[:, start::2].mean() for start in (0, 1))
    assert within_pairs < 0.3 * across_pairs


def test_contacts_are_left_out_of_the_noise() -> None:
    frames, free = _frames_with_shared_colour(4), np.ones(SHAPE, bool)
    free[40:90, 30:80] = False
    without = measure_noise(frames, [free] * 4).sigma_grey
    for frame in frames:
        frame[40:90, 30:80] += 60.0
    assert measure_noise(frames, [free] * 4).sigma_grey == pytest.approx(without)


def test_scaled_noise_has_the_scaled_standard_deviation() -> None:
    noise = measure_noise(_frames_with_shared_colour(2), [np.ones(SHAPE, bool)] * 2)
    assert noise.scaled(0.5).sigma_grey == pytest.approx(0.5 * noise.sigma_grey)
