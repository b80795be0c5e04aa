"""A simulated sensor unit into whose gel balls are pressed."""

from dataclasses import dataclass

import numpy as np

from drivers.types import Image
from fakes.gel.sensor import GelSensor
from fakes.objects.surfaces import GEL_DOME_RADIUS_MM
from fakes.studio.calibration_scenes import draw_press

MM_PER_PX = (0.060, 0.060)
"""Nominal scale of the simulated sensor; a unit's own differs by a percent or two."""
RADII_MM = (3.0, 5.0)


@dataclass(frozen=True)
class MadePress:
    name: str
    image: Image
    radius_mm: float
    centre_px: tuple[float, float]
    contact_px: float


class SimulatedGel:
    """reference: (H, W, 3) float32, the mean of thirty frames at rest."""

    def __init__(self, seed: int = 0) -> None:
        self.seed, self._sensor = seed, GelSensor(seed)
        rng = np.random.default_rng((seed, 1))
        self.reference = np.mean([self.frame(rng) for _ in range(30)], axis=0).astype(np.float32)

    def frame(self, rng: np.random.Generator) -> Image:
        """A frame without contact."""
        return self._sensor.render(None, 0.0, rng)

    def presses(self, count: int, seed: int = 0) -> list[MadePress]:
        """Presses of balls of 3 and 5 mm radius in turn, anywhere on the gel."""
        rng = np.random.default_rng((self.seed, 2, seed))
        return [self._press(number, rng) for number in range(count)]

    def _press(self, number: int, rng: np.random.Generator) -> MadePress:
        radius_mm, scale = RADII_MM[number % 2], np.array(self._sensor.mm_per_px)
        x, y = np.array((119.5, 159.5)) + rng.uniform((-4.5, -6.5), (4.5, 6.5)) / scale
        deep_mm = rng.uniform(0.30, 0.50)
        contact = float(np.sqrt(2.0 * deep_mm / (1.0 / radius_mm + 1.0 / GEL_DOME_RADIUS_MM)) / scale[0])
        image = draw_press(None, self.seed, (x, y, contact), radius_mm).image
        return MadePress(f"{number:02d}", image, radius_mm, (float(x), float(y)), contact)
