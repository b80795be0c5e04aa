"""The estimator slip on real pictures of other sensors."""

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.images import read_image
from rig.tactile.contact.background import auto_background
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.estimator import SlipEstimator

Image = NDArray[np.uint8]


def held(background: Image, image: Image, frames: int = 14) -> list[SlipSample]:
    """Show one image repeatedly, each time with different noise."""
    tracker, rng = SlipEstimator(background), np.random.default_rng(0)
    noisy = (np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for _ in range(frames))
    return [tracker.update(picture, i * 16_666_667) for i, picture in enumerate(noisy)]


@pytest.mark.slow
def test_balls_on_a_real_gel_are_refused(real_data: Path) -> None:
    folder = real_data / "gelsight_ball"
    background = read_image(folder / "background.png")
    balls = sorted(folder.glob("*mm_*.png"))
    assert len(balls) > 60
    for ball in balls[::3]:
        states = {sample.state for sample in held(background, read_image(ball))[1:]}
        assert states == {State.UNOBSERVABLE}, ball.name


@pytest.mark.slow
def test_every_ball_pressed_into_a_real_digit_is_refused() -> None:
    folder = Path(os.environ.get("RIG_DIGIT_BALLS", ""))
    if not (folder / "circles.csv").is_file():
        pytest.skip("RIG_DIGIT_BALLS does not name the folder that digit_balls/rebuild.py makes")
    background = read_image(folder / "background.png")
    balls = sorted((folder / "frames").glob("*.png"))
    assert len(balls) == 31
    for ball in balls:
        states = {sample.state for sample in held(background, read_image(ball))[1:]}
        assert states == {State.UNOBSERVABLE}, ball.name


@pytest.mark.slow
@pytest.mark.parametrize("panel", range(1, 10))
def test_real_contact_at_rest_has_a_constant_angle(real_data: Path, panel: int) -> None:
    panels = [read_image(real_data / "aurova_figures" / "panels" / f"{i}_raw.png") for i in range(1, 10)]
    smallest = tuple(min(p.shape[axis] for p in panels) for axis in (0, 1))
    panels = [p[: smallest[0], : smallest[1]] for p in panels]
    samples = held(auto_background(panels), panels[panel - 1])
    assert samples[-1].state is State.TRACKING
    answered = [sample.angle_deg for sample in samples if sample.angle_deg is not None]
    assert len(answered) >= 10
    # Two of the nine are nearly round: their sigma is a third of a degree.
    assert all(abs(angle) < 1.0 for angle in answered)
