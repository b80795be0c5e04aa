"""The colour map learnt from one contact, and the height that slopes integrate to."""

import cmath
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.tactile.contact.gate import ContactGate
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.height import Field, Gradient, relief

ROWS, COLUMNS = 80, 60


def dent(angle_deg: float) -> Field:
    """Return the height of a smooth dent, (80, 60)."""
    x, y = np.meshgrid(np.arange(COLUMNS) - 29.5, 39.5 - np.arange(ROWS))
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
    region = ContactGate().find(seen)
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
