"""Regions missed by a network: regions in which all colours changed are added, shadows are not."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.overlooked import overlooked_part

SIZE = (96, 128)


def drawn(centre: tuple[int, int], half_axes: tuple[int, int]) -> Image:
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.ellipse(mask, centre, half_axes, 0, 0, 360, 1, -1)
    return mask


def changed(where: Image, by: tuple[float, float, float]) -> NDArray[np.float32]:
    noise = np.random.default_rng(0).normal(0.0, 0.01, (3, *where.shape))
    return np.asarray(noise + np.reshape(by, (3, 1, 1)) * where, np.float32)


CONTACT = drawn((48, 64), (38, 12))
LEFT_HALF = CONTACT * (np.arange(SIZE[0]) < 48).astype(np.uint8)


def test_missed_half_of_a_contact_is_added() -> None:
    part = overlooked_part(LEFT_HALF, changed(CONTACT, (0.3, -0.4, 0.2)))
    whole = part | LEFT_HALF
    assert cv2.connectedComponents(whole)[0] == 2, "it is one part"
    assert np.abs(whole.astype(int) - CONTACT).sum() < 0.15 * CONTACT.sum()


@pytest.mark.parametrize("by", [(0.3, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.0, 0.0)])
def test_shadow_of_one_colour_adds_nothing(by: tuple[float, float, float]) -> None:
    assert overlooked_part(LEFT_HALF, changed(CONTACT, by)) is None


def test_foot_of_a_dent_is_not_added() -> None:
    assert overlooked_part(CONTACT, changed(drawn((48, 64), (41, 15)), (0.3, -0.4, 0.2))) is None


@pytest.mark.parametrize(("share", "goes_on"), [(0.35, False), (0.8, True)])
def test_wide_slope_around_a_contact_is_not_added(share: float, goes_on: bool) -> None:
    around = drawn((48, 64), (46, 28)) - CONTACT
    seen = changed(CONTACT, (0.6, -0.8, 0.4)) + changed(around, (0.6 * share, -0.8 * share, 0.4 * share))
    assert (overlooked_part(CONTACT, seen) is not None) == goes_on


def test_missed_contact_is_added_if_two_colours_change() -> None:
    nothing = np.zeros_like(CONTACT)
    part = overlooked_part(nothing, changed(CONTACT, (0.3, -0.4, 0.0)))
    assert np.abs(part.astype(int) - CONTACT).sum() < 0.15 * CONTACT.sum()
    assert overlooked_part(nothing, changed(drawn((48, 64), (4, 3)), (0.3, -0.4, 0.2))) is None, "a speck"
    assert overlooked_part(CONTACT, changed(CONTACT, (0.3, -0.4, 0.0))) is None, "it was found"


def test_global_light_change_is_not_a_contact() -> None:
    everywhere = np.ones_like(CONTACT)
    assert overlooked_part(np.zeros_like(CONTACT), changed(everywhere, (0.3, 0.3, 0.3))) is None
    assert overlooked_part(everywhere, changed(everywhere, (0.3, 0.3, 0.3))) is None
