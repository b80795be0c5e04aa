"""Simulated presses of balls into the simulated sensor's gel, with known radius and place."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.shapes import SURFACE_MM_PER_PX
from fakes.objects.surfaces import FAR_MM, GEL_DOME_RADIUS_MM, SURFACE_PX, Surface

MM_PER_PX = (0.060, 0.060)
"""Nominal scale of the simulated sensor; a unit's own differs by a percent or two."""
_RADII_MM = (3.0, 5.0)


@dataclass(frozen=True, slots=True, eq=False)
class MadePress:
    """A simulated press: its picture, the ball's radius, and where and how wide the contact is."""

    name: str
    image: Image
    radius_mm: float
    centre_px: tuple[float, float]
    contact_px: float


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedGel:
    """One simulated sensor unit. reference: (H, W, 3) float32, the mean of thirty frames at rest."""

    seed: int = 0
    _sensor: GelSensor = field(init=False)
    reference: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_sensor", GelSensor(self.seed))
        rng = np.random.default_rng((self.seed, 1))
        still = np.mean([self.frame(rng) for _ in range(30)], axis=0)
        object.__setattr__(self, "reference", still.astype(np.float32))

    def frame(self, rng: np.random.Generator) -> Image:
        """A frame without contact, (H, W, 3) uint8 RGB."""
        return self._sensor.render(None, 0.0, rng)

    def presses(self, count: int, seed: int = 0) -> list[MadePress]:
        """Balls of 3 and 5 mm radius in turn, pressed in anywhere on the gel."""
        rng = np.random.default_rng((self.seed, 2, seed))
        return [self._press(i, rng) for i in range(count)]

    def _press(self, number: int, rng: np.random.Generator) -> MadePress:
        radius = _RADII_MM[number % 2]
        x, y = rng.uniform((-4.5, -6.5), (4.5, 6.5))
        deep = rng.uniform(0.30, 0.50)
        dome = (x**2 + y**2) / (2.0 * GEL_DOME_RADIUS_MM)
        imprint = Imprint(_ball(radius), 0.0, (float(x), float(y)), float(deep + dome))
        image = self._sensor.render(imprint, 0.0, rng)
        sx, sy = self._sensor.mm_per_px
        centre = (119.5 + float(x) / sx, 159.5 + float(y) / sy)
        contact = float(np.sqrt(2.0 * deep / (1.0 / radius + 1.0 / GEL_DOME_RADIUS_MM))) / sx
        return MadePress(f"{number:02d}", image, radius, centre, contact)


def _ball(radius_mm: float) -> Surface:
    """The surface of a sphere, 0 at its nearest point."""
    axis = (np.arange(SURFACE_PX) - 0.5 * (SURFACE_PX - 1)) * SURFACE_MM_PER_PX
    square = axis[:, None] ** 2 + axis[None, :] ** 2
    height = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0.0))
    height = np.where(square < radius_mm**2, height, FAR_MM)
    return Surface(np.minimum(height, FAR_MM).astype(np.float32), SURFACE_MM_PER_PX)
