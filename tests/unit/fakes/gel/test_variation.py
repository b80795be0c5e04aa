"""Sensor units that differ from their family, random contacts, and frames for training."""

from typing import Any

import numpy as np
import pytest

from fakes.gel.pad import GelPad
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import Variation, draw_variation
from fakes.objects.surfaces import build_surface
from fakes.studio.training_frames import RANDOM_SHAPE, random_contact
from rig.training.examples import simulated_examples


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def pressed() -> Imprint:
    return Imprint(build_surface(random_contact(rng(3)), 1, 0), 10.0, (0.0, 0.0), 0.5)


def test_varied_units_differ_and_are_reproducible(pressed: Imprint) -> None:
    frames = [GelSensor(5, variation=draw_variation(rng(n))).render(pressed, 0.0, rng()) for n in (1, 2, 1)]
    assert np.abs(frames[0].astype(int) - frames[1]).mean() > 5
    np.testing.assert_array_equal(frames[0], frames[2])


def test_variation_does_not_change_the_true_contact(pressed: Imprint) -> None:
    varied = GelSensor(5, variation=draw_variation(rng(1)))
    np.testing.assert_array_equal(varied.touching(pressed), GelSensor(5).touching(pressed))


class PlainLook:
    """A look whose membrane has the depth of the object only."""

    def dent(self, pressed: np.ndarray, dragged: np.ndarray) -> np.ndarray:
        return pressed


@pytest.mark.parametrize("film_px", [3, 5, 9])
def test_film_wider_than_the_familys_smooths_the_rim_of_a_look(pressed: Imprint, film_px: int) -> None:
    look: Any = PlainLook()
    sharp = GelPad((320, 240), (0.06, 0.06), look=look).dent(pressed)
    dent = GelPad((320, 240), (0.06, 0.06), variation=Variation(film_px=film_px), look=look).dent(pressed)
    steepest, before = (np.abs(np.diff(depth, axis=0)).max() for depth in (dent, sharp))
    assert steepest < 0.9 * before if film_px > 5 else np.array_equal(dent, sharp)


@pytest.mark.heavy
def test_training_frames_are_reproducible_and_have_labels() -> None:
    made = [simulated_examples(["2", "7"], 14, seed, (60, 80), random_share=0.5) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(made[0].frames, made[1].frames)
    assert (made[0].frames != made[2].frames).any()
    assert set(made[0].objects) <= {"2", "7", RANDOM_SHAPE}
    assert made[0].frames.shape == (14, 80, 60, 3)
    assert made[0].labels.shape == (14, 80, 60)
    share = made[0].labels.mean(axis=(1, 2)) / 255.0
    assert 0.02 < share[share > 0].mean() < 0.5
