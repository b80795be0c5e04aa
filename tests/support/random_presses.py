"""Random presses of the trial objects on one simulated gel: at rest, or turned during the hold."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.clock import to_ns
from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import find_object
from fakes.objects.surfaces import Surface, build_surface, depth_for_force

OBJECTS = ("1", "7", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
RATE_HZ = 30.0
OFF_S = 0.7
"""Time without contact before each press; longer than a gap within one grasp."""
TURN_AFTER_S = 0.6
"""Time from full depth to the start of a rotation."""


@dataclass(frozen=True)
class PressedFrame:
    """image: (H, W, 3) uint8 RGB. press: number of the press. turned_deg: rotation in this press so far."""

    image: Image
    time_ns: int
    press: int
    turned_deg: float


@dataclass(frozen=True)
class _Press:
    surface: Surface
    angle_deg: float
    centre_mm: tuple[float, float]
    tilt: tuple[float, float]
    depth_mm: float
    ramp_s: float
    tremor: float
    tremor_hz: float

    def imprint(self, since_s: float, turned_deg: float) -> Imprint | None:
        share = min(since_s / self.ramp_s, 1.0)
        if share <= 0.0:
            return None
        share *= 1.0 + self.tremor * math.sin(2.0 * math.pi * self.tremor_hz * since_s)
        angle = self.angle_deg + turned_deg
        return Imprint(self.surface, angle, self.centre_mm, share * self.depth_mm, self.tilt)


def blank(seed: int) -> Image:
    """Return the mean of some frames without contact, (H, W, 3) uint8 RGB."""
    gel, rng = GelSensor(seed), np.random.default_rng((seed, 1))
    return np.mean([gel.render(None, i / RATE_HZ, rng) for i in range(8)], axis=0).round().astype(np.uint8)


def random_presses(
    count: int, seed: int, hold_s: float = 1.2, turn_deg_s: float = 0.0, rate_hz: float = RATE_HZ
) -> Iterator[PressedFrame]:
    """Yield the frames of presses of the objects in turn, each by a hand that trembles a little.

    Object, side, angle, place, tilt, depth (0.3 to 2 N) and speed of a press are random. turn_deg_s: rate of
    the rotation that begins `TURN_AFTER_S` after the full depth, 0 for presses at rest.
    """
    gel, noise, number = GelSensor(seed), np.random.default_rng((seed, 2)), 0
    for place in range(count):
        press = _random_press(OBJECTS[place % len(OBJECTS)], np.random.default_rng((seed, 3, place)))
        for frame in range(round((OFF_S + press.ramp_s + hold_s) * rate_hz)):
            since_s, time_s = frame / rate_hz - OFF_S, 1.0 + number / rate_hz
            turned = turn_deg_s * max(since_s - press.ramp_s - TURN_AFTER_S, 0.0)
            image = gel.render(press.imprint(since_s, turned), time_s, noise)
            yield PressedFrame(image, to_ns(time_s), place, turned)
            number += 1


def _random_press(name: str, rng: np.random.Generator) -> _Press:
    sites = find_object(name).sites
    site = sites[int(rng.integers(len(sites)))]
    surface = build_surface(site, int(rng.choice((-1, 1))), int(rng.integers(1000)))
    tilt = (float(rng.normal(0.0, 0.008)), float(rng.normal(0.0, 0.008)))
    angle, centre = float(rng.uniform(-180.0, 180.0)), tuple(rng.uniform((-1.5, -2.0), (1.5, 2.0)).tolist())
    depth = depth_for_force(surface, float(rng.uniform(0.3, 2.0)), tilt, angle, centre)
    ramp_s, tremor, hz = (float(rng.uniform(*span)) for span in ((0.1, 0.8), (0.0, 0.02), (1.0, 4.0)))
    return _Press(surface, angle, centre, tilt, depth, ramp_s, tremor, hz)
