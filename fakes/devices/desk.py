"""A simulated DIGIT on a desk; an object is repeatedly pressed on its gel, turned and taken off."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.interfaces import TactileSensor
from drivers.types import Image
from fakes.devices.camera import FakeSource, Shutter
from fakes.faults import FaultScript
from fakes.gel.pad import rotate
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import find_object
from fakes.objects.surfaces import Surface, build_surface, depth_for_force
from fakes.studio.clips import FORCE_N, PIVOT_MM, TILT

RATE_HZ, CYCLE_S = 60.0, 16.0
"""Duration of a cycle, in which an object is pressed, turned twice and taken off."""
TOUCH_S, HELD_S, TURNS_S, OFF_S = 3.0, 3.5, (6.0, 11.0), 15.5
"""Times in a cycle: first touch, full force, start of both rotations, object taken off."""
TURN_RATE_DEG_S = 15.0


@dataclass(slots=True)
class Demonstration:
    """The motion of the object, shared by the fingertips that touch it.

    start_ns: start of the first cycle; None until the first frame of any fingertip is read. So a program that
    needs long to start does not miss the gel without contact.
    """

    start_ns: int | None = None

    def since_start_s(self, time_ns: int) -> float:
        """Return the time since the start in s, 0 for the first frame."""
        if self.start_ns is None:
            self.start_ns = time_ns
        return (time_ns - self.start_ns) / NS_PER_S


class DeskDigit(FakeSource, TactileSensor):
    """A simulated fingertip on a desk.

    side: +1, or -1 for a second sensor on the opposite side of the same object.
    """

    def __init__(self, serial: str, side: int, shown: Demonstration, clock: Clock) -> None:
        shutter = Shutter(RATE_HZ, phase_s=0.002 + 0.002 * (1 - side))
        super().__init__((serial,), shutter, self.draw, clock, FaultScript(()), 8 + side)
        self._side, self._shown = side, shown

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Do nothing: the light of this unit is fixed."""

    def draw(self, time_ns: int, rng: np.random.Generator) -> Image:
        """Return the image at a time, (H, W, 3) uint8 RGB. rng: draws the noise."""
        time_s, imprint = self._shown.since_start_s(time_ns), None
        if (share := _depth_share(time_s % CYCLE_S)) > 0.0:
            surface, depth_mm = _pressed_surface(self._side)
            angle_deg = self._side * _turned_deg(time_s)
            px, py = self._side * PIVOT_MM[0], PIVOT_MM[1]
            x, y = rotate(px, py, math.radians(angle_deg))
            imprint = Imprint(surface, angle_deg, (px - x, py - y), share * depth_mm, TILT)
        return _gel(20 + self._side).render(imprint, time_s, rng)

    def turn_deg(self, time_ns: int) -> float | None:
        """Return the rotation of the object since its first touch, counter-clockwise positive in this image.

        Returns None without contact.
        """
        time_s = self._shown.since_start_s(time_ns)
        return self._side * _turned_deg(time_s) if _depth_share(time_s % CYCLE_S) > 0.0 else None


def _depth_share(in_cycle_s: float) -> float:
    """Return the fraction of the full depth, 0 without contact."""
    if in_cycle_s >= OFF_S:
        return 0.0
    return min(max((in_cycle_s - TOUCH_S) / (HELD_S - TOUCH_S), 0.0), 1.0)


def _turned_deg(time_s: float) -> float:
    cycle, in_cycle_s = divmod(time_s, CYCLE_S)
    sizes_deg = np.random.default_rng(int(max(cycle, 0))).uniform(8.0, 25.0, len(TURNS_S))
    turned = 0.0
    for place, (begins_s, size_deg) in enumerate(zip(TURNS_S, sizes_deg, strict=True)):
        done = min(max((in_cycle_s - begins_s) * TURN_RATE_DEG_S, 0.0), float(size_deg))
        turned += done if place % 2 == 0 else -done
    return turned


_gel = lru_cache(maxsize=2)(GelSensor)


@lru_cache(maxsize=2)
def _pressed_surface(side: int) -> tuple[Surface, float]:
    """Return the face of a wrench that touches the gel, and its depth in mm at full force."""
    surface = build_surface(find_object("t1").sites[0], side, 0)
    return surface, depth_for_force(surface, FORCE_N, TILT, 0.0, (0.0, 0.0))
