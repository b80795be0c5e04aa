"""Contacts that grow: the growth is no rotation, and a rotation meanwhile is followed. SIMULATED."""

from itertools import pairwise

import numpy as np
import pytest

from fakes.objects.catalogue import find_object
from fakes.objects.surfaces import build_surface
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.estimator import SlipEstimator
from support.drawn_sensor import drawn_press
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


def drawn_growth(shares: np.ndarray, turns_deg: np.ndarray, rate_hz: float) -> list[SlipSample]:
    """Return the answered samples of a drawn edge that has shares of its full size."""
    tracker, samples = SlipEstimator(drawn_press(None, noise=0.0)), []
    tracker.update(drawn_press(None, seed=99), -round(1e9 / rate_hz))
    for i, (share, turn) in enumerate(zip(shares, turns_deg, strict=True)):
        axes, strength = (80.0 * share, 25.0 * share), 0.6 + 0.4 * share
        image = drawn_press(10.0 + turn, axes, strength=strength, seed=i)
        samples.append(tracker.update(image, round(i * 1e9 / rate_hz)))
    return [sample for sample in samples if sample.angle_deg is not None]


@pytest.mark.parametrize("rate_hz", [10.0, 25.0])
def test_rotation_of_a_growing_contact_is_known_within_a_tenth_and_two_sigma(rate_hz: float) -> None:
    """The area grows fivefold. Only the rotation after the contact has settled counts from the zero."""
    samples = drawn_growth(np.linspace(0.45, 1.0, 14), np.linspace(0.0, 65.0, 14), rate_hz)
    assert any(sample.state is State.REKEYED for sample in samples)
    last = samples[-1]
    assert last.angle_deg == pytest.approx(65.0, rel=0.1)
    assert abs(last.angle_deg - 65.0) < 2.0 * last.sigma_deg


@pytest.fixture(scope="module")
def tenfold() -> list[SlipSample]:
    """A contact that grows to the tenfold area without a rotation."""
    return drawn_growth(np.sqrt([*np.geomspace(0.1, 1.0, 40), *[1.0] * 12]), np.zeros(52), 25.0)


def test_contact_growing_tenfold_keeps_its_angle(tenfold: list[SlipSample]) -> None:
    assert len(tenfold) > 40
    assert np.abs(np.array([sample.angle_deg for sample in tenfold], float)).max() < 2.5


def test_sigma_of_a_growing_contact_does_not_shrink_with_a_keyframe(tenfold: list[SlipSample]) -> None:
    rekeyed = [pair for pair in pairwise(tenfold) if pair[1].state is State.REKEYED]
    assert rekeyed
    for before, after in rekeyed:
        assert after.sigma_deg >= before.sigma_deg
