"""The texture of a contact, the colour map learnt from it, and the height that slopes integrate to."""

import cmath
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.types import Image
from rig.tactile.contact.gate import find_contact
from rig.tactile.sample import State
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.height import Field, Gradient, relief
from rig.tactile.slip.loops import ROWS, SQUARE, X, Y
from rig.tactile.slip.texture import STRONGEST, fine_scale, strongest, structure_of
from support.drawn_sensor import specked
from support.slip_frames import HEIGHT, WIDTH, texture_of

FULL = np.ones((80, 60), np.uint8)


def line(angle_deg: float) -> Field:
    """The relative difference of a thin grey line through the middle, (h, w, 3)."""
    x, y = np.meshgrid(np.arange(WIDTH) - WIDTH / 2 + 0.5, HEIGHT / 2 - 0.5 - np.arange(HEIGHT))
    turn = math.radians(angle_deg)
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    bright = 0.1 * np.exp(-0.5 * (across / 1.5) ** 2) * (np.abs(along) < 30)
    return np.repeat(bright[..., None], 3, axis=2).astype(np.float32)


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
    gap = direction_deg(structure_of(line(angle_deg))) - angle_deg
    assert (gap + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=1.0)


def test_strongest_points_lie_on_the_line_and_have_unit_energy() -> None:
    texture, rows = texture_of(line(30.0)), np.zeros((ROWS, STRONGEST), np.float32)
    found = strongest(texture, FULL, rows, 29.5 + 39.5j, np.arange)
    count, _ = found
    assert rows[SQUARE, :count].sum() == pytest.approx(1.0, abs=1e-4)
    places = (rows[X, :count] + 1j * rows[Y, :count]) * np.exp(1j * math.radians(30.0))
    assert np.abs(places.imag).max() < 6.0, "along and across the line, in work pixels"
    empty = texture_of(np.zeros((HEIGHT, WIDTH, 3), np.float32))
    assert strongest(empty, FULL, rows, 0j, np.arange) is None
    assert empty.richness(FULL) == 0.0


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


@pytest.mark.heavy
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_line_turning_on_a_resting_bulge_is_followed(way: float) -> None:
    tracker = SlipEstimator(picture(None, 0))
    turns = [0.0] * 10 + [way * 1.5 * i for i in range(28)]
    samples = [tracker.update(picture(20.0 + t, i + 1), round(i * 4e7)) for i, t in enumerate(turns)]
    assert samples[-1].state in (State.TRACKING, State.REKEYED)
    # less than a frame turns: none is lost where a keyframe is taken
    assert samples[-1].angle_deg - samples[9].angle_deg == pytest.approx(turns[-1], abs=1.0)


@pytest.mark.heavy
def test_darkening_specks_do_not_stop_tracking() -> None:
    tracker = SlipEstimator(specked(picture(None, 0), 0.25))
    turns = [0.0] * 10 + [1.5 * i for i in range(28)]
    images = (specked(picture(20.0 + turn, i + 1), 0.5) for i, turn in enumerate(turns))
    samples = [tracker.update(image, round(i * 4e7)) for i, image in enumerate(images)]
    answered = np.array([sample.angle_deg for sample in samples[9:]], float)
    off = np.abs(answered - answered[0] - turns[9:])
    assert off.mean() < 1.0
    assert off.max() < 5.0, "held for three frames of 1.5 degrees at most: at the start, after a keyframe"


HIGH, WIDE = 80, 60


def dent(angle_deg: float) -> Field:
    """Return the height of a smooth dent, (80, 60)."""
    x, y = np.meshgrid(np.arange(WIDE) - 29.5, 39.5 - np.arange(HIGH))
    turned = (x + 1j * y) * cmath.exp(-1j * math.radians(angle_deg))
    reach = np.clip(1.0 - (turned.real / 19.0) ** 2 - (turned.imag / 7.0) ** 2, 0.0, None)
    return np.asarray(cv2.GaussianBlur(6.0 * np.sqrt(reach).astype(np.float32), (0, 0), 1.5), np.float32)


def slopes(height: Field) -> Gradient:
    down, across = np.gradient(height)
    return np.asarray(across + 1j * down, np.complex64)


azimuths = st.tuples(st.floats(0, 360), st.floats(80, 160), st.floats(80, 160), st.sampled_from([-1, 1])).map(
    lambda v: (v[0], v[0] + v[3] * v[1], v[0] - v[3] * v[2])
)


@given(angle=st.floats(-90, 90), azimuths_deg=azimuths, gains=st.tuples(*[st.floats(0.6, 1.4)] * 3))
def test_colour_map_is_learnt_for_any_led_directions(
    angle: float, azimuths_deg: tuple[float, ...], gains: tuple[float, ...]
) -> None:
    true = slopes(dent(angle))
    leds = [0.2 * g * cmath.exp(1j * math.radians(a)) for a, g in zip(azimuths_deg, gains, strict=True)]
    seen = np.stack([(true * led).real for led in leds], axis=2)
    seen = (seen + np.random.default_rng(0).normal(0, 0.004, seen.shape)).astype(np.float32)
    region = find_contact(seen)
    learnt = learn_map(seen, region.mask)
    inside = region.mask > 0
    found, known = learnt.apply(seen)[inside], true[inside]
    alike = float(np.vdot(found, known).real) / float(np.linalg.norm(found) * np.linalg.norm(known))
    assert alike > 0.97, "same directions, handedness and proportions, at any scale"
    planes = learnt.slopes(seen, (10, 20, 30, 40))
    np.testing.assert_allclose(
        planes[..., 0] + 1j * planes[..., 1], learnt.apply(seen)[20:60, 10:40], atol=1e-4
    )


@pytest.mark.parametrize("step", [1, 2])
def test_gradient_integrates_to_its_relief(step: int) -> None:
    height = dent(20.0)[::step, ::step]
    found = relief(slopes(height), (height > 0.1).astype(np.uint8), step)
    assert np.abs(found - height).max() < 0.08 * height.max()
