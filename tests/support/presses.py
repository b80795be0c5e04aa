"""A surface pressed into a simulated gel, frame by frame, as slip answers it."""

from collections.abc import Iterable

import numpy as np

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.surfaces import Surface, depth_for_force
from rig.tactile.sample import SlipSample
from rig.tactile.slip.estimator import SlipEstimator

RATE_HZ, BLANKS = 60.0, 8


def followed_presses(
    surface: Surface, presses: Iterable[tuple[float, float]], gel_seed: int = 5
) -> list[SlipSample]:
    """Return a sample for each press. presses: force in N and turn in degrees."""
    gel, rng = GelSensor(gel_seed), np.random.default_rng(1)
    blank = np.mean([gel.render(None, i / RATE_HZ, rng) for i in range(BLANKS)], 0).round().astype(np.uint8)
    estimator = SlipEstimator(blank, 1.0)
    samples = []
    for i, (force_n, turn_deg) in enumerate(presses):
        depth = depth_for_force(surface, force_n, angle_deg=turn_deg)
        at_s = 1.0 + i / RATE_HZ
        image = gel.render(Imprint(surface, turn_deg, depth_mm=depth), at_s, rng)
        samples.append(estimator.update(image, round(at_s * 1e9)))
    return samples
