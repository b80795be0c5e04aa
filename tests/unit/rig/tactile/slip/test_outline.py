"""The long axis of a contact region corrects uncertain angles, and only those."""

import math

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.types import Image
from rig.tactile.slip.outline import Outline, axis_of

SURE, UNSURE = math.radians(1.0) ** 2, math.radians(8.0) ** 2


def ellipse(angle_deg: float, along_px: int = 40, across_px: int = 12) -> Image:
    """A filled ellipse whose long axis has turned counter-clockwise from the x axis."""
    mask = np.zeros((120, 160), np.uint8)
    cv2.ellipse(mask, (80, 60), (along_px, across_px), -angle_deg, 0, 360, 1, -1)
    return mask


def corrected(turn_deg: float, estimated_deg: float, variance: float, across_px: int = 12) -> float:
    """The angle in degrees after a rotation of the region that was estimated otherwise."""
    outline = Outline()
    outline.correct(0.0, SURE, ellipse(20.0, across_px=across_px))
    turned = ellipse(20.0 + turn_deg, across_px=across_px)
    return math.degrees(outline.correct(math.radians(estimated_deg), variance, turned)[0])


@given(angle_deg=st.floats(-180.0, 180.0))
def test_axis_of_an_ellipse_has_its_direction_and_elongation(angle_deg: float) -> None:
    axis = axis_of(ellipse(angle_deg))
    assert abs(math.remainder(axis.angle_rad - math.radians(angle_deg), math.pi)) < math.radians(1.5)
    assert abs(axis.elongation - 40 / 12) < 0.25


@given(turn_deg=st.floats(-25.0, 25.0), share=st.floats(0.5, 0.9))
def test_uncertain_angle_moves_towards_the_rotation_of_the_axis(turn_deg: float, share: float) -> None:
    estimated_deg = share * turn_deg
    angle_deg = corrected(turn_deg, estimated_deg, UNSURE)
    assert abs(angle_deg - turn_deg) <= abs(estimated_deg - turn_deg) + 0.5
    if abs(turn_deg) > 10.0:
        assert abs(angle_deg - turn_deg) < 0.8 * abs(estimated_deg - turn_deg)


@given(turn_deg=st.floats(-40.0, 40.0), error_deg=st.floats(-30.0, 30.0))
def test_certain_angle_stays(turn_deg: float, error_deg: float) -> None:
    assert abs(corrected(turn_deg, turn_deg + error_deg, SURE) - turn_deg - error_deg) < 1.0


@given(turn_deg=st.floats(-40.0, 40.0))
def test_round_region_does_not_correct(turn_deg: float) -> None:
    assert abs(corrected(turn_deg, 0.0, UNSURE, across_px=39)) < 0.5


def test_rotation_beyond_a_quarter_turn_is_taken_from_the_estimate() -> None:
    assert abs(corrected(130.0, 125.0, UNSURE) - 130.0) < 3.0


def test_variance_falls_if_both_agree_and_not_if_they_differ_much() -> None:
    outline = Outline()
    outline.correct(0.0, SURE, ellipse(0.0))
    _, agreed = outline.correct(math.radians(15.0), UNSURE, ellipse(15.0))
    _, apart = outline.correct(0.0, UNSURE, ellipse(60.0))
    assert agreed < 0.3 * UNSURE
    assert apart > 0.9 * UNSURE


def test_forgotten_outline_counts_from_the_next_frame() -> None:
    outline = Outline()
    outline.correct(0.0, SURE, ellipse(0.0))
    outline.forget()
    angle_rad, _ = outline.correct(0.0, UNSURE, ellipse(50.0))
    assert angle_rad == 0.0


def test_outline_of_a_resting_bulge_does_not_hold_an_angle_back() -> None:
    assert corrected(0.0, 25.0, UNSURE, across_px=24) == 25.0
