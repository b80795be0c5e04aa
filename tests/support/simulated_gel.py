"""A simulated sensor unit into whose gel balls are pressed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import Look
from fakes.objects.shapes import SURFACE_MM_PER_PX
from fakes.objects.surfaces import FAR_MM, GEL_DOME_RADIUS_MM, SURFACE_PX, Surface

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
    """A simulated sensor: frames without contact, and presses of balls."""

    def __init__(self, seed: int = 0) -> None:
        self.seed, self._sensor = seed, GelSensor(seed)

    @cached_property
    def reference(self) -> NDArray[np.float32]:
        """Mean of frames at rest, (H, W, 3)."""
        rng = np.random.default_rng((self.seed, 1))
        return np.mean([self.frame(rng) for _ in range(30)], axis=0).astype(np.float32)

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


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPress:
    """A press: the frame (H, W, 3) uint8 RGB, and the colour change in it without noise, grey levels."""

    image: Image
    change: NDArray[np.float32]


def draw_press(
    look: Look | None, unit_seed: int, circle: tuple[float, float, float], radius_mm: float
) -> DrawnPress:
    """Draw the press of a ball whose contact is a circle: x, y and radius in px.

    look: of a real unit, None for a simulated unit. unit_seed: seed of the simulated unit and of the noise.
    """
    sensor = GelSensor(unit_seed, look=look)
    scale, rng = np.array(sensor.mm_per_px), np.random.default_rng((unit_seed, 89))
    dome_mm = GEL_DOME_RADIUS_MM if look is None else look.dome_mm
    x, y = (np.array(circle[:2]) - (119.5, 159.5)) * scale
    contact_mm = min(circle[2] * float(scale[0]), 0.95 * radius_mm)
    deep = radius_mm - np.sqrt(radius_mm**2 - contact_mm**2) + contact_mm**2 / (2.0 * dome_mm)
    imprint = Imprint(
        _ball(radius_mm), 0.0, (float(x), float(y)), float(deep + (x**2 + y**2) / (2.0 * dome_mm))
    )
    return DrawnPress(sensor.render(imprint, 0.0, rng), sensor.change(imprint))


def _ball(radius_mm: float) -> Surface:
    """Return the surface of a sphere, 0 at its closest point."""
    axis = (np.arange(SURFACE_PX) - 0.5 * (SURFACE_PX - 1)) * SURFACE_MM_PER_PX
    square = axis[:, None] ** 2 + axis[None, :] ** 2
    height = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0.0))
    height = np.where(square < radius_mm**2, height, FAR_MM)
    return Surface(np.minimum(height, FAR_MM).astype(np.float32), SURFACE_MM_PER_PX)
