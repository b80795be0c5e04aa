"""From colours to gradients without a calibration, and the alignment of gradients."""

import cmath
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.tactile.contact.gate import ContactGate
from rig.tactile.slip.channel import Channel
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.height import Gradient, relief
from rig.tactile.slip.keyframe import make_keyframe
from rig.tactile.slip.loops import values_at
from rig.tactile.slip.parameters import SLOPES
from rig.tactile.slip.registration import align
from rig.tactile.slip.sampling import GradientField, sharpened

Field = NDArray[np.float32]
ROWS, COLUMNS = 80, 60


def dent(
    angle_deg: float, half_axes: tuple[float, float] = (19.0, 7.0), at: tuple[float, float] = (0, 0)
) -> Field:
    """Height of a smooth dent, (80, 60); its gradient is what a map should find."""
    turn = math.radians(angle_deg)
    x, y = np.meshgrid(np.arange(COLUMNS) - 29.5 - at[0], 39.5 + at[1] - np.arange(ROWS))
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    reach = np.clip(1.0 - (along / half_axes[0]) ** 2 - (across / half_axes[1]) ** 2, 0.0, None)
    return cv2.GaussianBlur(np.sqrt(reach).astype(np.float32) * 6.0, (0, 0), 1.5)


def slopes(height: Field) -> Gradient:
    down, across = np.gradient(height)
    return (across + 1j * down).astype(np.complex64)


def colours(gradient: Gradient, azimuths_deg: tuple[float, ...], gains: tuple[float, ...]) -> Field:
    """What three lamps at these azimuths make of a gradient."""
    lamps = [g * cmath.exp(1j * math.radians(a)) for a, g in zip(azimuths_deg, gains, strict=True)]
    return np.stack([0.2 * (gradient * lamp).real for lamp in lamps], axis=2).astype(np.float32)


lamp_azimuths = st.tuples(
    st.floats(0, 360), st.floats(80, 160), st.floats(80, 160), st.sampled_from([-1, 1])
).map(lambda v: (v[0], v[0] + v[3] * v[1], v[0] - v[3] * v[2]))
lamp_gains = st.tuples(*[st.floats(0.6, 1.4)] * 3)


@given(angle=st.floats(-90, 90), azimuths=lamp_azimuths, gains=lamp_gains)
def test_colour_map_is_learnt_for_any_led_directions(
    angle: float, azimuths: tuple[float, ...], gains: tuple[float, ...]
) -> None:
    true = slopes(dent(angle))
    seen = colours(true, azimuths, gains)
    seen += np.random.default_rng(0).normal(0, 0.004, seen.shape).astype(np.float32)
    region = ContactGate().find(seen)
    assert region is not None
    learnt = learn_map(seen, region.mask)
    assert learnt is not None
    found = learnt.apply(seen)
    inside = region.mask > 0
    alike = float(np.vdot(found[inside], true[inside]).real) / float(
        np.linalg.norm(found[inside]) * np.linalg.norm(true[inside])
    )
    assert alike > 0.97, "same directions, handedness and proportions, at any scale"


def test_frame_without_contact_gives_no_colour_map() -> None:
    assert learn_map(np.zeros((80, 60, 3), np.float32), np.ones((80, 60), np.uint8)) is None


def test_a_gradient_integrates_to_its_relief() -> None:
    height = dent(20.0)
    found = relief(slopes(height), (height > 0.1).astype(np.uint8))
    assert np.abs(found - height).max() < 0.08 * height.max()


ALWAYS_FOUND_DEG = 20.0
"""Largest turn that one alignment always finds from a start at zero: 2,400 of 2,400 random cases. Of 3,000
cases from 20 to 25 degrees it missed 101, and reported each of these as not settled."""


@given(
    turn=st.floats(-25, 25),
    shift=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    slope=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    gain=st.floats(0.9, 1.1),
)
def test_alignment_finds_rotation_and_shift(
    turn: float, shift: tuple[float, float], slope: tuple[float, float], gain: float
) -> None:
    before, after = dent(10.0), dent(10.0 + turn, at=shift)
    key = make_keyframe(slopes(before), (before > 0.2).astype(np.uint8))
    assert key is not None
    tilted = gain * slopes(after) + complex(*slope)
    field = GradientField(tilted.astype(np.complex64), (after > 0.2).astype(np.uint8))
    found = align(key, field, 0.0, 0j)
    if abs(turn) > ALWAYS_FOUND_DEG and not found.settled:
        return
    assert math.degrees(found.angle_rad) == pytest.approx(turn, abs=0.3)
    assert (found.shift_px.real, found.shift_px.imag) == pytest.approx(shift, abs=0.15)
    assert found.misfit < 0.2
    assert found.gain == pytest.approx(gain, abs=0.05)
    further = align(key, field, 0.0, 0j, to_the_end=True)
    assert (further.angle_rad, further.shift_px) == (found.angle_rad, found.shift_px)
    assert not found.settled or abs(math.degrees(further.further_rad)) < 0.02, "nothing worth the time"


def ribbed(outline_deg: float, ribs_deg: float) -> Field:
    """A dent with ribs; its outline and its ribs have directions of their own."""
    body, turn = dent(outline_deg, (19.0, 9.0)), math.radians(ribs_deg)
    x, y = np.meshgrid(np.arange(COLUMNS) - 29.5, 39.5 - np.arange(ROWS))
    ribs = 0.5 * np.cos(2.0 * math.pi / 7.0 * (y * math.cos(turn) - x * math.sin(turn)))
    return (body + ribs * np.minimum(body, 1.0)).astype(np.float32)


@pytest.mark.parametrize("turn_deg", [-12.0, 12.0])
def test_curvature_shows_that_an_outline_leans_but_its_ribs_do_not_turn(turn_deg: float) -> None:
    before = ribbed(10.0, 10.0)
    key = make_keyframe(slopes(before), (before > 0.2).astype(np.uint8))
    assert key is not None
    found = {}
    for name, ribs_deg in (("turned", 10.0 + turn_deg), ("leaning", 10.0)):
        after = ribbed(10.0 + turn_deg, ribs_deg)
        found[name] = align(key, GradientField(slopes(after), (after > 0.2).astype(np.uint8)), 0.0, 0j)
    assert math.degrees(found["turned"].angle_rad) == pytest.approx(turn_deg, abs=0.3)
    assert abs(math.degrees(found["turned"].bent_rad)) < 0.3
    leaning, bent = (math.degrees(v) for v in (found["leaning"].angle_rad, found["leaning"].bent_rad))
    assert abs(leaning) > 1.0, "the outline turns the angle"
    assert abs(leaning) < 2.0 * abs(bent), "which is within two sigma"
    assert abs(leaning + bent) < abs(leaning)


def test_smooth_ball_has_less_contrast_than_an_edge() -> None:
    contrast = {}
    for name, half_axes in (("ball", (12.0, 12.0)), ("oval", (15.0, 11.0)), ("edge", (22.0, 4.0))):
        height = dent(0.0, half_axes)
        key = make_keyframe(slopes(height), (height > 0.2).astype(np.uint8))
        assert key is not None
        contrast[name] = key.contrast
    assert contrast["ball"] < 0.05 < 0.18 < contrast["oval"] < contrast["edge"]


def test_degenerate_contact_returns_finite_values_or_none() -> None:
    flat = np.zeros((80, 60), np.complex64)
    assert make_keyframe(flat, np.ones((80, 60), np.uint8)) is None
    line = np.full((80, 60), 1j, np.complex64)
    key = make_keyframe(line, np.ones((80, 60), np.uint8))
    if key is not None:
        found = align(key, GradientField(line, np.ones((80, 60), np.uint8)), 0.0, 0j)
        assert math.isfinite(found.angle_rad)
        assert math.isfinite(key.contrast)
    edge = dent(0.0)
    key = make_keyframe(slopes(edge), (edge > 0.2).astype(np.uint8))
    assert key is not None
    lost = align(key, GradientField(slopes(edge), np.zeros((80, 60), np.uint8)), 0.0, 0j)
    assert lost.overlap == 0.0
    assert lost.misfit == math.inf


def read(field: GradientField, place: complex) -> tuple[NDArray[np.float32], float]:
    """The sharpened gradient at a place, and how much of what is around lies in the contact."""
    nothing = np.zeros((2, 1), np.float32)
    point = np.array([place], np.complex64)
    at = Channel(field.planes, point, 0j, nothing, nothing[0], np.zeros((6, 2, 1), np.float32), turns=1.0)
    found = values_at(at, 0.0, 0j)
    return found[:2, 0], float(found[2, 0])


@given(st.floats(4.0, 54.0), st.floats(4.0, 74.0))
def test_interpolation_of_a_linear_field_is_exact(x: float, y: float) -> None:
    rows, columns = np.mgrid[0:80, 0:60].astype(np.float32)
    gradient = columns + 2 * rows + 1j * columns * rows
    field = GradientField(gradient.astype(np.complex64), np.ones((80, 60), np.uint8))
    values, inside = read(field, x + 1j * y)
    assert inside == pytest.approx(1.0)
    fine = 1.0 - SLOPES.broad_share
    assert values == pytest.approx([fine * (x + 2 * y), fine * x * y], rel=1e-4)


def test_sharpening_keeps_fine_structure_and_turns_with_the_field() -> None:
    line = np.zeros((80, 60), np.complex64)
    line[40] = 1.0 + 2.0j
    found = sharpened(line, SLOPES.broad_share)
    assert abs(found[40, 30]) > 0.8 * abs(line[40, 30])
    assert abs(found[43, 30]) < 0.2 * abs(line[40, 30])
    turned = (line * np.complex64(1j)).astype(np.complex64)
    np.testing.assert_allclose(sharpened(turned, SLOPES.broad_share), 1j * found, atol=1e-6)


@pytest.mark.parametrize("place", [(-1.0, 5.0), (5.0, -0.5), (59.5, 5.0), (5.0, 80.0), (math.nan, 1.0)])
def test_samples_outside_the_image_are_zero(place: tuple[float, float]) -> None:
    field = GradientField(np.ones((80, 60), np.complex64), np.ones((80, 60), np.uint8))
    values, inside = read(field, complex(*place))
    assert not values.any()
    assert inside == 0.0


def test_alignment_to_noise_is_not_settled() -> None:
    height = dent(10.0, (22.0, 4.0))
    key = make_keyframe(slopes(height), (height > 0.2).astype(np.uint8))
    assert key is not None
    rubbish = (
        np.random.default_rng(1).normal(0, 0.1, (80, 60, 2)).astype(np.float32).view(np.complex64)[..., 0]
    )
    mask = np.ones((80, 60), np.uint8)
    assert align(key, GradientField(slopes(height), mask), 0.05, 0.5 + 0j).settled
    assert not align(key, GradientField(rubbish, mask), 0.0, 0j).settled
