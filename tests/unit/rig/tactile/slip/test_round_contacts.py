"""Round contacts: the rotation of a smooth one is unobservable, that of a textured one is not. SIMULATED."""

import numpy as np
import pytest

from drivers.clock import to_ns
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import Ball, ContactShape
from fakes.objects.surfaces import build_surface, depth_for_force
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State
from support.marks import long
from support.presses import followed_presses
from support.random_presses import blank

pytestmark = pytest.mark.slow

FORCE_N, STILL, TURNS_DEG = 4.0, 12, np.arange(0.0, 20.1, 0.8)


def followed(ball: ContactShape, force_n: float = FORCE_N, seed: int = 3) -> list[SlipSample]:
    """A ball that rests for some frames, and then turns."""
    presses = [(force_n, turn) for turn in [0.0] * STILL + TURNS_DEG.tolist()]
    return followed_presses(build_surface(ball, 1, seed), presses)


def ball(radius_mm: float, texture: str = "none", texture_mm: float = 0.0) -> ContactShape:
    return ContactShape((Ball(radius_mm=radius_mm),), texture=texture, texture_mm=texture_mm, pitch_mm=1.5)


@pytest.mark.parametrize(
    ("radius_mm", "force_n"),
    [(3.0, 4.0), (6.0, 8.0), (25.0, 4.0), *long((4.0, 4.0), (8.0, 4.0))],
)
def test_smooth_ball_of_any_depth_is_refused(radius_mm: float, force_n: float) -> None:
    samples = followed(ball(radius_mm), force_n)
    assert {sample.state for sample in samples[1:]} == {State.UNOBSERVABLE}


@pytest.mark.parametrize("radius_mm", [3.0, 12.0, *long(6.0, 25.0)])
@pytest.mark.parametrize("center_mm", [(0.0, 8.0), (6.0, 8.0), *long(((5.0, 0.0),))])
def test_smooth_ball_that_the_border_cuts_is_refused(
    radius_mm: float, center_mm: tuple[float, float]
) -> None:
    gel, surface, rng = GelSensor(1), build_surface(ball(radius_mm), 1, 3), np.random.default_rng(0)
    imprint = Imprint(surface, 0.0, center_mm, depth_for_force(surface, 8.0, centre_mm=center_mm))
    estimator = choose_estimator("slip").make(blank(1))
    images = [gel.render(imprint, 1.0 + frame / 30.0, rng) for frame in range(8)]
    samples = [estimator.update(image, to_ns(1.0 + frame / 30.0)) for frame, image in enumerate(images)]
    assert {sample.state for sample in samples[1:]} == {State.UNOBSERVABLE}


@pytest.mark.parametrize("radius_mm", [8.0, *long(12.0)])
@pytest.mark.parametrize("texture", ["leather", "letters", *long("fabric")])
@pytest.mark.parametrize("texture_mm", [0.08, *long(0.02, 0.05)])
def test_ball_with_weak_grain_is_refused_or_has_a_large_sigma(
    radius_mm: float, texture: str, texture_mm: float
) -> None:
    samples = followed(ball(radius_mm, texture, texture_mm), seed=1)
    result = [
        (sample.angle_deg - turn, sample.sigma_deg)
        for sample, turn in zip(samples, [*[0.0] * STILL, *TURNS_DEG], strict=True)
        if sample.angle_deg is not None and sample.sigma_deg is not None
    ]
    assert all(abs(off - result[0][0]) < 2.0 * sigma_deg for off, sigma_deg in result[1:])


@pytest.mark.parametrize("radius_mm", [12.0, *long(25.0)])
@pytest.mark.parametrize("texture", ["ribs", "leather", "letters", *long("knurl", "fabric")])
def test_textured_ball_is_followed(radius_mm: float, texture: str) -> None:
    samples = followed(ball(radius_mm, texture, 0.12))
    angles = np.array([sample.angle_deg for sample in samples[STILL - 1 :]], float)
    off = angles - angles[0] - np.concatenate([[0.0], TURNS_DEG])
    assert np.abs(off).max() < 1.5
    assert abs(off[-1]) < 2.0 * samples[-1].sigma_deg
