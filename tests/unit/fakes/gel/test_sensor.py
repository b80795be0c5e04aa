"""Simulated tactile frames: reproducible, different per unit, and turned by the object's rotation."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import ContactShape, Cylinder
from fakes.objects.surfaces import build_surface, depth_for_force
from fakes.studio.clips import ROLLER, ROLLER_TURN_DEG, Scene, contact_shape, roller_imprint

SENSOR = GelSensor(21)
RIBS = build_surface(contact_shape(ROLLER), 1, 0)
BAR = build_surface(ContactShape((Cylinder(radius_mm=6.0, length_mm=9.0),)), 1, 0)


def pressed(angle_deg: float) -> Imprint:
    return Imprint(BAR, angle_deg, depth_mm=depth_for_force(BAR, 1.0))


def rolled(share: float, sign: float = 1.0) -> Imprint:
    return roller_imprint(Scene(ROLLER, angle_deg=sign * ROLLER_TURN_DEG), RIBS, share)


def contact_mask(imprint: Imprint, sensor: GelSensor) -> np.ndarray:
    """Where object and gel touch, 0 or 255; gaps of a texture are filled."""
    reach = max(round(0.9 / sensor.mm_per_px[0]), 1) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    padded = cv2.copyMakeBorder(sensor.touching(imprint), reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    return cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach]


def axis_deg(mask: np.ndarray, sensor: GelSensor) -> float:
    """Image angle of the mask's long axis on the gel, -90 to 90."""
    rows, columns = np.nonzero(mask)
    spread = np.cov(columns * sensor.mm_per_px[0], rows * sensor.mm_per_px[1])
    dx, dy = np.linalg.eigh(spread)[1][:, 1]
    return float((np.degrees(-np.arctan2(dy, dx)) + 90.0) % 180.0 - 90.0)


@pytest.mark.heavy
@given(st.floats(-80.0, 80.0), st.floats(-8.0, 8.0), st.sampled_from([1, 2, 3]))
def test_mask_turns_with_the_object_counter_clockwise_as_seen(start: float, turn: float, unit: int) -> None:
    sensor = GelSensor(unit)
    before, after = (axis_deg(contact_mask(pressed(at), sensor), sensor) for at in (start, start + turn))
    assert (after - before + 90.0) % 180.0 - 90.0 == pytest.approx(turn, abs=0.6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_outline_of_a_roller_turns_by_more_than_its_ribs(sign: float) -> None:
    first, last = rolled(0.0, sign), rolled(1.0, sign)
    assert abs(last.angle_deg - first.angle_deg) < 5.0
    outlines = [axis_deg(SENSOR.touching(imprint), SENSOR) for imprint in (first, last)]
    assert 12.0 <= sign * (outlines[1] - outlines[0]) <= 15.0


def test_roller_rolls_across_the_pad() -> None:
    middles = [np.argwhere(SENSOR.touching(rolled(share))).mean(axis=0)[0] for share in (0.0, 0.5, 1.0)]
    assert (np.diff(middles) * SENSOR.mm_per_px[1] > 1.0).all()
