"""The ribbed roller: its outline leans by 12 to 15 degrees while its ribs turn by less than 5."""

import numpy as np

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.surfaces import build_surface
from fakes.studio.clips import ROLLER, ROLLER_TURN_DEG, Scene, contact_shape, roller_imprint

SENSOR = GelSensor(21)
SURFACE = build_surface(contact_shape(ROLLER), 1, 0)


def pressed(share: float, angle_deg: float = ROLLER_TURN_DEG) -> Imprint:
    return roller_imprint(Scene(ROLLER, angle_deg=angle_deg), SURFACE, share)


def outline_deg(imprint: Imprint) -> float:
    """Image angle of the long axis of the contact."""
    rows, columns = np.nonzero(SENSOR.touching(imprint))
    across, down = SENSOR.mm_per_px
    dx, dy = np.linalg.eigh(np.cov(columns * across, rows * down))[1][:, 1]
    return float((np.degrees(-np.arctan2(dy, dx)) + 90.0) % 180.0 - 90.0)


def test_outline_turns_by_more_than_the_ribs() -> None:
    for sign in (1.0, -1.0):
        first, last = pressed(0.0, sign * ROLLER_TURN_DEG), pressed(1.0, sign * ROLLER_TURN_DEG)
        assert abs(last.angle_deg - first.angle_deg) < 5.0
        assert 12.0 <= sign * (outline_deg(last) - outline_deg(first)) <= 15.0


def test_contact_rolls_across_the_pad() -> None:
    middles = [np.argwhere(SENSOR.touching(pressed(share))).mean(axis=0)[0] for share in (0.0, 0.5, 1.0)]
    moved_mm = np.diff(middles) * SENSOR.mm_per_px[1]
    assert (moved_mm > 1.0).all()
