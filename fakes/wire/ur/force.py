"""The force sensor in the simulated arm's flange: the object's weight, the push of the table, and zeroing."""

import math

from drivers.types import Vector6
from fakes.wire.ur.frames import Frame
from fakes.world.force_torque import NOTHING, FlangeSensor, carried_wrench, table_push_n
from fakes.world.world import World

_LOAD_EVERY = 4
"""The load changes slowly: it is computed every fourth cycle."""


class ForceSensor:
    """Force (N) and torque (N m) at the TCP in base axes, compensated for the payload.

    The sensor has an offset until it is zeroed.
    """

    def __init__(self, world: World) -> None:
        self._world, self._floor_m = world, world.layout.floor_z_m
        self._sensor = FlangeSensor(world.seed)
        self._zero = self._slow = NOTHING
        self._cycle = 0

    def sense(self, time_ns: int, tcp: Frame) -> Vector6:
        """Return the reading of this control cycle."""
        self._cycle += 1
        if self._cycle % _LOAD_EVERY == 1:
            self._slow = self._sensor.drifted(carried_wrench(self._world, time_ns), time_ns)
        a, b, c, d, e, f = self._slow
        push = table_push_n(self._floor_m, tcp[2])
        return _less(self._sensor.shown((a, b, c + push, d, e, f), time_ns), self._zero)

    def zero(self, wrench: Vector6) -> None:
        """Subtract a reading from all that follow."""
        a, b, c, d, e, f = (z + w for z, w in zip(self._zero, wrench, strict=True))
        self._zero = (a, b, c, d, e, f)


def magnitude(wrench: Vector6) -> float:
    """Length of the force, N."""
    return math.hypot(*wrench[:3])


def _less(a: Vector6, b: Vector6) -> Vector6:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5]
