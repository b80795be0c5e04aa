"""The texture of a contact: what is fine in it, whatever its colours, and which way it runs."""

import math

import cv2
import numpy as np
import pytest

from drivers.types import Image
from rig.tactile.sample import State
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.evidence import Fit
from rig.tactile.slip.height import Field
from rig.tactile.slip.judge import sigma_alone
from rig.tactile.slip.keys import ContactPose
from rig.tactile.slip.loops import values_at
from rig.tactile.slip.texture import FEWEST_POINTS, TextureField, fine_scale, make_texture_key, structure
from support.drawn_sensor import specked

HEIGHT, WIDTH = 160, 120
GREY = (1.0, 1.0, 1.0)


def line(angle_deg: float, colour: tuple[float, float, float] = GREY, width_px: float = 1.5) -> Field:
    """The relative difference of a thin line through the middle, (h, w, 3)."""
    x, y = np.meshgrid(np.arange(WIDTH) - WIDTH / 2 + 0.5, HEIGHT / 2 - 0.5 - np.arange(HEIGHT))
    turn = math.radians(angle_deg)
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    bright = 0.1 * np.exp(-0.5 * (across / width_px) ** 2) * (np.abs(along) < 30)
    return (bright[..., None] * np.array(colour)).astype(np.float32)


def bulge() -> Field:
    """That of a broad oval bulge of gel: each colour is brighter towards its LED."""
    x, y = np.meshgrid(np.arange(WIDTH) - WIDTH / 2, np.arange(HEIGHT) - HEIGHT / 2)
    dome = np.exp(-0.5 * ((x / 24.0) ** 2 + (y / 14.0) ** 2))
    towards = [x * math.cos(a) + y * math.sin(a) for a in (0.0, 2.1, 4.2)]
    return np.stack([0.35 * dome * t / 20.0 for t in towards], axis=2).astype(np.float32)


def direction_deg(planes: Field) -> float:
    """The direction of all that is there, image angle modulo 180 degrees."""
    turned = planes[..., 0].sum() + 1j * planes[..., 1].sum()
    return math.degrees(-np.angle(turned) / 2.0 + math.pi / 2.0) % 180.0


@pytest.mark.parametrize("angle_deg", [0.0, 25.0, 60.0, 135.0])
def test_direction_of_a_line_is_measured(angle_deg: float) -> None:
    gap = direction_deg(structure(line(angle_deg), 1.0)) - angle_deg
    assert (gap + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=1.0)


def test_texture_key_takes_the_strongest_points() -> None:
    field, mask = TextureField(line(30.0), 2), np.ones((80, 60), np.uint8)
    key = make_texture_key(field, mask, 30 + 40j)
    assert key is not None
    assert key.squares.sum() == pytest.approx(1.0, abs=1e-4)
    places = key.points_px * np.exp(1j * math.radians(30.0))  # back to along and across
    assert np.abs(places.imag).max() < 6.0
    assert make_texture_key(TextureField(np.zeros((HEIGHT, WIDTH, 3), np.float32), 2), mask, 0j) is None
    assert FEWEST_POINTS > 1


def test_texture_key_matches_before_and_after_rotation() -> None:
    before, mask = TextureField(line(20.0), 2), np.ones((80, 60), np.uint8)
    middle = 29.75 + 39.75j
    key = make_texture_key(before, mask, middle)
    assert key is not None
    assert values_at(key.within(before, middle), 0.0, 0j) == pytest.approx(key.template, abs=1e-4)
    after = TextureField(line(55.0), 2)
    turned = values_at(key.within(after, middle), math.radians(35.0), 0j)
    alike = float((turned * key.template).sum()) / math.sqrt(float((turned**2).sum()))
    rest = values_at(key.within(after, middle), 0.0, 0j)
    at_rest = float((rest * key.template).sum()) / math.sqrt(float((rest**2).sum()))
    assert alike > 0.95
    assert at_rest < 0.5 * alike


@pytest.mark.parametrize(("shape", "scale"), [((320, 240), 2), ((80, 60), 1), ((100, 70), 1)])
def test_sampling_uses_existing_pixels_only(shape: tuple[int, int], scale: int) -> None:
    assert fine_scale((*shape, 3), (60, 80) if shape[0] >= 80 else (shape[1], shape[0])) == scale


def picture(line_deg: float | None, seed: int) -> Image:
    """A fingertip, (320, 240, 3): a bulge of gel that rests, and on it a thin line that does not."""
    rng = np.random.default_rng(seed)
    difference = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    if line_deg is not None:
        difference = bulge() + line(line_deg)
    wide = cv2.resize(difference, (240, 320), interpolation=cv2.INTER_LINEAR)
    return np.clip(np.rint(110.0 * (1.0 + wide) + rng.normal(0, 1.0, wide.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_line_turning_on_a_resting_bulge_is_followed(way: float) -> None:
    tracker = SlipEstimator(picture(None, 0))
    turns = [0.0] * 10 + [way * 1.5 * i for i in range(28)]
    samples = [tracker.update(picture(20.0 + t, i + 1), round(i * 4e7)) for i, t in enumerate(turns)]
    assert samples[-1].state in (State.TRACKING, State.REKEYED)
    assert samples[-1].angle_deg is not None
    assert samples[9].angle_deg is not None
    # less than a frame turns: none is lost where a keyframe is taken
    assert samples[-1].angle_deg - samples[9].angle_deg == pytest.approx(turns[-1], abs=1.0)


def test_darkening_specks_do_not_stop_tracking() -> None:
    tracker = SlipEstimator(specked(picture(None, 0), 0.25))
    turns = [0.0] * 10 + [1.5 * i for i in range(28)]
    images = (specked(picture(20.0 + turn, i + 1), 0.5) for i, turn in enumerate(turns))
    samples = [tracker.update(image, round(i * 4e7)) for i, image in enumerate(images)]
    answered = np.array([sample.angle_deg for sample in samples[9:]], float)
    off = np.abs(answered - answered[0] - turns[9:])
    assert off.mean() < 1.0
    assert off.max() < 5.0, "held for three frames of 1.5 degrees at most: at the start, after a keyframe"


def test_sigma_grows_with_low_contrast_and_poor_texture_fit() -> None:
    def sigma(contrast: float, slopes: float, texture: float) -> float:
        return sigma_alone(contrast, Fit(ContactPose(0.0, 0j), slopes, texture, 1.0))

    edge, egg = sigma(20.0, 0.93, 0.9), sigma(0.5, 0.93, 0.5)
    assert edge < math.radians(1.0) < math.radians(3.0) < egg
    assert sigma(20.0, 0.93, 0.5) > edge
    assert sigma(20.0, 0.5, 0.9) > edge
    assert math.isfinite(sigma(0.2, -1.0, 0.0))
    assert sigma(20.0, 1.0, 1.0) > 0.0
