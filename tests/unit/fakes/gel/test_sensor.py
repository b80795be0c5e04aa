"""Simulated tactile frames: repeatable, different per unit, and true to the turn of the object."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import load_catalogue
from fakes.objects.shapes import Ball, ContactShape, Cylinder, Pad
from fakes.objects.surfaces import Surface, build_surface, depth_for_force

SENSOR = GelSensor(1)
BAR = build_surface(ContactShape((Cylinder(radius_mm=6.0, length_mm=9.0),)), 1, 0)
TEXTURED = build_surface(load_catalogue()["t7"].sites[2], 1, 0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def pressed(surface: Surface, angle_deg: float = 0.0, force_n: float = 1.0) -> Imprint:
    return Imprint(surface, angle_deg, depth_mm=depth_for_force(surface, force_n))


def grey(image: Image) -> np.ndarray:
    return image.astype(np.float32)


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


def test_noise_differs_from_frame_to_frame_by_a_grey_level_or_two() -> None:
    first, second = SENSOR.render(None, 0.0, rng(1)), SENSOR.render(None, 0.0, rng(2))
    assert 0.8 < (grey(first) - grey(second)).std() / np.sqrt(2.0) < 2.5


def test_background_has_the_colours_of_a_digit() -> None:
    """Red light from the left, green on the right, blue over red at the dark top."""
    for unit in range(6):
        frame = grey(GelSensor(unit).render(None, 0.0, rng()))
        left, right, top = (
            frame[150:200, :50].mean((0, 1)),
            frame[150:200, -50:].mean((0, 1)),
            frame[:20, 60:180].mean((0, 1)),
        )
        assert np.argmax(left) == 0
        assert np.argmax(right) == 1
        assert top[2] > top[0]


def test_without_contact_the_frame_is_the_background() -> None:
    clear = replace(pressed(BAR), depth_mm=-1.0)
    assert np.array_equal(SENSOR.render(clear, 0.0, rng()), SENSOR.render(None, 0.0, rng()))
    assert not contact_mask(clear).any()


def test_light_touch_changes_only_its_surroundings() -> None:
    frame, empty = SENSOR.render(pressed(BAR, 0.0, 0.3), 0.0, rng()), SENSOR.render(None, 0.0, rng())
    change = np.abs(grey(frame) - grey(empty)).max(axis=2)
    touching = contact_mask(pressed(BAR, 0.0, 0.3)) > 0
    assert change[touching].mean() > 10.0
    assert change[:25].max() <= 1.0
    assert change[-25:].max() <= 1.0


def test_upper_slope_turns_red_and_lower_slope_blue() -> None:
    """As in the real frames: a horizontal bar's crescents, against the background."""
    frame, empty = SENSOR.render(pressed(BAR), 0.0, rng()), SENSOR.render(None, 0.0, rng())
    change = grey(frame) - grey(empty)
    rows, columns = np.nonzero(contact_mask(pressed(BAR)))
    middle = rows.mean()
    upper = change[rows[rows < middle], columns[rows < middle]].mean(0)
    lower = change[rows[rows > middle], columns[rows > middle]].mean(0)
    assert upper[0] > 5.0 > -5.0 > upper[2]
    assert lower[2] > 5.0 > -5.0 > lower[0]


@given(st.floats(-80.0, 80.0), st.floats(-8.0, 8.0), st.sampled_from([1, 2, 3]))
@settings(max_examples=40)
def test_mask_turns_with_the_object_counter_clockwise_as_seen(start: float, turn: float, unit: int) -> None:
    sensor = GelSensor(unit)
    before = axis_deg(contact_mask(sensor=sensor, imprint=pressed(BAR, start)), sensor)
    after = axis_deg(contact_mask(sensor=sensor, imprint=pressed(BAR, start + turn)), sensor)
    assert (after - before + 90.0) % 180.0 - 90.0 == pytest.approx(turn, abs=0.6)


def test_the_far_fingers_picture_turns_the_other_way() -> None:
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


@given(st.floats(0.2, 1.6), st.floats(0.2, 0.6), st.sampled_from(["1", "3", "10", "t1", "t4", "t6"]))
@settings(max_examples=30)
def test_contact_grows_with_force(force_n: float, more_n: float, key: str) -> None:
    surface = build_surface(load_catalogue()[key].sites[1], 1, 0)
    small = contact_mask(pressed(surface, 10.0, force_n))
    large = contact_mask(pressed(surface, 10.0, force_n + more_n))
    assert (large > 0).sum() > (small > 0).sum()
    assert (large >= small).all()


def test_typical_grip_covers_a_share_of_the_image_as_in_real_labels() -> None:
    """Real labels cover 7 to 44 per cent."""
    for model in load_catalogue().values():
        for site in model.sites:
            share = (contact_mask(pressed(build_surface(site, 1, 1))) > 0).mean()
            assert 0.05 < share < 0.45, (model.name, share)


@pytest.mark.parametrize("key", ["t1", "t2", "t3", "t4", "t6", "t7"])
def test_elongated_objects_make_contacts_with_a_long_axis(key: str) -> None:
    for site in load_catalogue()[key].sites:
        rows, columns = np.nonzero(contact_mask(pressed(build_surface(site, 1, 0), 10.0)))
        short, long = np.sqrt(np.linalg.eigvalsh(np.cov(columns, rows)))
        assert long / short > 1.5


def test_smooth_round_sites_make_contacts_without_one() -> None:
    round_sites = [s for m in load_catalogue().values() for s in m.sites if s.contact.smooth_round]
    for site in round_sites:
        rows, columns = np.nonzero(contact_mask(pressed(build_surface(site, 1, 0), 10.0)))
        short, long = np.sqrt(np.linalg.eigvalsh(np.cov(columns, rows)))
        assert long / short < 1.1


def test_tilt_moves_the_contact_towards_the_side_that_leans_in() -> None:
    pad = build_surface(ContactShape((Pad(length_mm=60.0, width_mm=60.0),)), 1, 0)
    level, tilted = pressed(pad), replace(pressed(pad), tilt=(0.03, 0.0))
    columns = [np.nonzero(contact_mask(imprint))[1].mean() for imprint in (level, tilted)]
    assert columns[1] < columns[0] - 5.0


def test_lag_moves_the_surroundings_and_not_the_contact() -> None:
    bar = pressed(BAR, 15.0)
    lagging = replace(bar, lag_deg=2.0)
    assert np.array_equal(contact_mask(lagging), contact_mask(bar))
    change = np.abs(grey(SENSOR.render(lagging, 0.0, rng())) - grey(SENSOR.render(bar, 0.0, rng())))
    outside = contact_mask(bar) == 0
    assert change[outside].max() > 2.0
    assert change.mean() < 2.0


def test_light_drifts_slowly_and_by_little() -> None:
    frames = [grey(SENSOR.render(None, time_s, rng(1))).mean() for time_s in np.arange(0.0, 90.0, 3.0)]
    assert 0.001 < np.ptp(frames) / np.mean(frames) < 0.05
    soon = grey(SENSOR.render(None, 0.5, rng(1))) - grey(SENSOR.render(None, 0.0, rng(1)))
    assert np.abs(soon).max() <= 2.0
