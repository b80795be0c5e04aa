"""A grip that grows from a quarter of a newton to eight turns nothing. SIMULATED."""

import numpy as np
import pytest

from fakes.objects.catalogue import find_object
from fakes.objects.surfaces import build_surface
from support.presses import followed_presses

FORCES_N = (*np.geomspace(0.25, 8.0, 48), *[8.0] * 6)


def drift(object_id: str, site: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles from the first answer on, deg, and their sigmas; the contact grows threefold and more."""
    surface = build_surface(find_object(object_id).sites[site], 1, seed=1)
    samples = followed_presses(surface, [(force_n, 0.0) for force_n in FORCES_N], gel_seed=6)
    answered = [sample for sample in samples if sample.angle_deg is not None]
    assert len(answered) > len(FORCES_N) // 2
    assert answered[-1].contact_area_px > 3.0 * answered[0].contact_area_px
    angles = np.array([sample.angle_deg for sample in answered], float)
    return angles - angles[0], np.array([sample.sigma_deg for sample in answered], float)


@pytest.mark.parametrize(("object_id", "site"), [("t1", 0), ("t4", 0), ("t5", 2), ("t7", 1)])
def test_growing_contact_with_an_edge_keeps_its_angle(object_id: str, site: int) -> None:
    angles, _ = drift(object_id, site)
    assert np.abs(angles).max() < 0.5


@pytest.mark.parametrize(("object_id", "site"), [("1", 0), ("7", 0)])
def test_sigma_covers_the_drift_of_a_poorly_observable_contact(object_id: str, site: int) -> None:
    """A barrel that is round both ways, and a rounded corner."""
    angles, sigmas = drift(object_id, site)
    assert (np.abs(angles) < np.maximum(0.5, 2.0 * sigmas)).all()
