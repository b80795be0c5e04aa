"""The force sensor in the simulated arm's flange: what hangs, what presses, and what drifts."""

import math

import numpy as np

from drivers.types import Vector6
from fakes.slip import GRAVITY
from fakes.wire.ur_frames import Frame
from fakes.world import World

FLOOR_STIFFNESS_N_M = 10_000.0
NOISE_N, NOISE_NM = 0.08, 0.004
_NOISE_SAMPLES = 997
_LOOK_EVERY = 4
"""The load changes slowly: the world is asked once in four cycles."""


class ForceSensor:
    """Force (N) and torque (N m) at the TCP in base axes, compensated for the payload that was set.

    The sensor has an offset until it is zeroed. floor_z_m: the height at which the TCP meets
    something hard. Torques of the load are not modelled.
    """

    def __init__(self, world: World, floor_z_m: float = 0.0) -> None:
        self._world, self._floor_m = world, floor_z_m
        rng = np.random.default_rng(world.seed)
        noise = rng.normal(0.0, (NOISE_N,) * 3 + (NOISE_NM,) * 3, (_NOISE_SAMPLES, 6))
        self._noise = [tuple(row) for row in noise.tolist()]
        self._offset = tuple(rng.normal(0.0, (1.0,) * 3 + (0.05,) * 3).tolist())
        self._load_n = 0.0
        self._cycle = 0
        self.contact_cycles = 0

    def sense(self, time_ns: int, tcp: Frame) -> Vector6:
        """The reading of this control cycle."""
        self._cycle += 1
        if self._cycle % _LOOK_EVERY == 1:
            self._load_n = self._hanging(time_ns)
        depth = self._floor_m - tcp[2]
        self.contact_cycles = self.contact_cycles + 1 if depth >= 0.0 else 0
        push = max(depth, 0.0) * FLOOR_STIFFNESS_N_M - self._load_n
        n, o = self._noise[self._cycle % _NOISE_SAMPLES], self._offset
        return n[0] + o[0], n[1] + o[1], n[2] + o[2] + push, n[3] + o[3], n[4] + o[4], n[5] + o[5]

    def zero(self, wrench: Vector6) -> None:
        """Take the present reading as zero."""
        a, b, c, d, e, f = (o - w for o, w in zip(self._offset, wrench, strict=True))
        self._offset = (a, b, c, d, e, f)

    def _hanging(self, time_ns: int) -> float:
        model, moment = self._world.model, self._world.moment_at(time_ns)
        return model.mass_kg * GRAVITY * moment.loaded if model and moment.held else 0.0


def magnitude(wrench: Vector6) -> float:
    """Length of the force, N."""
    return math.hypot(*wrench[:3])
