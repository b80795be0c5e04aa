"""Simulated tactile frames: reproducible, different per unit, and turned by the object's rotation."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import ContactShape, Cylinder
from fakes.objects.surfaces import Surface, build_surface, depth_for_force

SENSOR = GelSensor(1)
BAR = build_surface(ContactShape((Cylinder(radius_mm=6.0, length_mm=9.0),)), 1, 0)


def pressed(surface: Surface, angle_deg: float = 0.0, force_n: float = 1.0) -> Imprint:
    return Imprint(surface, angle_deg, depth_mm=depth_for_force(surface, force_n))


def contact_mask(imprint: Imprint, sensor: GelSensor = SENSOR) -> np.ndarray:
    """Where object and gel touch, 0 or 255; gaps of a texture are filled."""
    reach = max(round(0.9 / sensor.mm_per_px[0]), 1) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    padded = cv2.copyMakeBorder(sensor.touching(imprint), reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    return cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach]


def axis_deg(mask: np.ndarray, sensor: GelSensor = SENSOR) -> float:
    """Image angle of the mask's long axis on the gel, -90 to 90."""
    rows, columns = np.nonzero(mask)
    spread = np.cov(columns * sensor.mm_per_px[0], rows * sensor.mm_per_px[1])
    dx, dy = np.linalg.eigh(spread)[1][:, 1]
    return float((np.degrees(-np.arctan2(dy, dx)) + 90.0) % 180.0 - 90.0)


@pytest.mark.slow
@given(st.floats(-80.0, 80.0), st.floats(-8.0, 8.0), st.sampled_from([1, 2, 3]))
def test_mask_turns_with_the_object_counter_clockwise_as_seen(start: float, turn: float, unit: int) -> None:
    sensor = GelSensor(unit)
    before = axis_deg(contact_mask(sensor=sensor, imprint=pressed(BAR, start)), sensor)
    after = axis_deg(contact_mask(sensor=sensor, imprint=pressed(BAR, start + turn)), sensor)
    assert (after - before + 90.0) % 180.0 - 90.0 == pytest.approx(turn, abs=0.6)
