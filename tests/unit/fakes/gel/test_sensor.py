"""Simulated tactile frames: repeatable, different per unit, and true to the turn of the object."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import Ball, ContactShape, Cylinder
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


def test_image_of_the_opposite_finger_turns_the_other_way() -> None:
    """An axis that the camera's side sees at +25 degrees, the far side sees at -25."""
    contact = ContactShape((Cylinder(radius_mm=6.0, length_mm=9.0, axis_deg=25.0),))
    near, far = (axis_deg(contact_mask(pressed(build_surface(contact, side, 0)))) for side in (1, -1))
    assert near == pytest.approx(25.0, abs=1.0)
    assert far == pytest.approx(-25.0, abs=1.0)


def test_imprint_moves_with_its_centre() -> None:
    """A small ball, because the gel's dome draws a broad contact towards the middle."""
    still = pressed(build_surface(ContactShape((Ball(radius_mm=3.0),)), 1, 0))
    masks = [contact_mask(i) for i in (still, replace(still, centre_mm=(1.5, -2.0)))]
    (row0, column0), (row1, column1) = (np.argwhere(mask).mean(0) for mask in masks)
    assert (column1 - column0) * SENSOR.mm_per_px[0] == pytest.approx(1.5, abs=0.12)
    assert (row1 - row0) * SENSOR.mm_per_px[1] == pytest.approx(-2.0, abs=0.12)
