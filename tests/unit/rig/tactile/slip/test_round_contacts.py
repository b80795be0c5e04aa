"""Round contacts: a smooth one tells no turn, one with a texture does. SIMULATED."""

import numpy as np
import pytest

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import Ball, ContactShape
from fakes.objects.surfaces import build_surface, depth_for_force
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.estimator import SlipEstimator

FORCE_N, STILL, TURNS_DEG = 4.0, 12, np.arange(0.0, 20.1, 0.8)


def followed(ball: ContactShape, force_n: float = FORCE_N, seed: int = 3) -> list[SlipSample]:
    """A ball that rests for some frames, and then turns."""
    surface, gel, rng = build_surface(ball, 1, seed), GelSensor(5), np.random.default_rng(1)
    blank = np.mean([gel.render(None, i / 60, rng) for i in range(8)], 0).round().astype(np.uint8)
    estimator = SlipEstimator(blank, 1.0)
    samples = []
    for i, turn in enumerate([0.0] * STILL + TURNS_DEG.tolist()):
        depth = depth_for_force(surface, force_n, angle_deg=turn)
        image = gel.render(Imprint(surface, turn, depth_mm=depth), 1.0 + i / 60, rng)
        samples.append(estimator.update(image, round((1.0 + i / 60) * 1e9)))
    return samples


def ball(radius_mm: float, texture: str = "none", texture_mm: float = 0.0) -> ContactShape:
    return ContactShape((Ball(radius_mm=radius_mm),), texture=texture, texture_mm=texture_mm, pitch_mm=1.5)


@pytest.mark.parametrize(
    ("radius_mm", "force_n"), [(3.0, 8.0), (4.0, 4.0), (6.0, 8.0), (8.0, 4.0), (12.0, 8.0), (25.0, 4.0)]
)
def test_a_smooth_ball_is_refused_however_steep(radius_mm: float, force_n: float) -> None:
    assert {sample.state for sample in followed(ball(radius_mm), force_n)} == {State.UNOBSERVABLE}


@pytest.mark.parametrize("radius_mm", [8.0, 12.0])
@pytest.mark.parametrize("texture", ["leather", "fabric", "letters"])
@pytest.mark.parametrize("texture_mm", [0.02, 0.05, 0.08])
def test_a_ball_with_weak_grain_is_refused_or_its_sigma_tells(
    radius_mm: float, texture: str, texture_mm: float
) -> None:
    samples = followed(ball(radius_mm, texture, texture_mm), seed=1)
    told = [
        (sample.angle_deg - turn, sample.sigma_deg)
        for sample, turn in zip(samples, [*[0.0] * STILL, *TURNS_DEG], strict=True)
        if sample.angle_deg is not None and sample.sigma_deg is not None
    ]
    assert all(abs(off - told[0][0]) < 2.0 * sigma_deg for off, sigma_deg in told[1:])


@pytest.mark.parametrize("radius_mm", [12.0, 25.0])
@pytest.mark.parametrize("texture", ["ribs", "knurl", "leather", "fabric", "letters"])
def test_a_ball_with_a_texture_is_followed(radius_mm: float, texture: str) -> None:
    samples = followed(ball(radius_mm, texture, 0.12))
    angles = np.array([sample.angle_deg for sample in samples[STILL - 1 :]], float)
    off = angles - angles[0] - np.concatenate([[0.0], TURNS_DEG])
    assert np.abs(off).max() < 1.5
    assert samples[-1].sigma_deg is not None
    assert abs(off[-1]) < 2.0 * samples[-1].sigma_deg
