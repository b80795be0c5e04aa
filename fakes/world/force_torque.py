"""Simulate the force-torque sensor in the flange of a UR5e: the wrench of the held object, and its errors.

An object that hangs in the fingers loads them with its weight, and with a torque of weight times lever. If
this torque exceeds the friction torque of the pads, they carry only the friction torque. The far end of the
object then stays on its support, which carries the rest and adds a friction force.
"""

import math
from operator import add, sub

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Vector6
from fakes.world.kinematics import six
from fakes.world.world import World

NOTHING: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FLOOR_STIFFNESS_N_M = 10_000.0
"""Stiffness of fingers that stand on the table (our assumption)."""
SUPPORT_FRICTION = 0.3
"""Friction coefficient between the end of the object and the table (our assumption)."""
BIAS_N, BIAS_NM = 1.0, 0.05
NOISE_N, NOISE_NM = 0.1, 0.005
DRIFT_N, DRIFT_NM = 0.15, 0.008
STEP_N, STEP_NM = 0.05, 0.002
"""Errors of the sensor: standard deviations of bias, noise and drift, and resolution.

They are our assumptions for the few seconds of a lift, well within the data sheet of the UR5e, which states a
precision of 3.5 N and 0.2 N m and an accuracy of 4.0 N and 0.3 N m over range, life and temperature."""
_DRIFT_PERIODS_S = (8.0, 40.0)
_CYCLE_NS = 2_000_000
_NOISE_CYCLES = 9973


def carried_wrench(world: World, time_ns: int) -> Vector6:
    """Return force (N) and torque (N m) of the held object on the TCP in the base's axes; zeros without one.

    Both are proportional to the fraction of the weight on the pads (`WorldState.loaded`).
    """
    grip = world.grip_at(time_ns)
    if grip is None:
        return NOTHING
    state, load = grip
    side = math.copysign(1.0, load.lever_m)
    across, down = math.cos(state.object_turn_rad), abs(math.sin(state.object_turn_rad))
    weight_nm = load.weight_n * abs(load.lever_m) * across
    torque_nm = min(weight_nm, load.turning_limit_nm)
    # Torque about the fingertips' axis: the support pushes the far end up, and friction pulls it outwards.
    support_n = (weight_nm - torque_nm) / (load.reach_m * (across + SUPPORT_FRICTION * down))
    hanging_n = min(load.weight_n - support_n, load.sliding_limit_n)
    share = state.loaded
    drag_n = -side * SUPPORT_FRICTION * support_n
    return share * drag_n, 0.0, -share * hanging_n, 0.0, -share * side * torque_nm, 0.0


class FlangeSensor:
    """Measures force (N) and torque (N m) at the TCP in base axes, compensated for the payload.

    It adds bias, drift and noise, all drawn from the world's seed, and rounds to the resolution; a new
    reading every 2 ms. every: the load changes slowly; it is computed at every Nth reading.
    """

    def __init__(self, world: World, every: int = 1) -> None:
        rng = np.random.default_rng((world.seed, 43))
        self._world, self._every, self._readings = world, every, 0
        self._zero = self._load = NOTHING
        self._bias = _six(rng, BIAS_N, BIAS_NM)
        self._noise = rng.normal(0.0, _spread(NOISE_N, NOISE_NM), (_NOISE_CYCLES, 6))
        self._drift = _six(rng, DRIFT_N, DRIFT_NM)
        self._rates = (2.0 * math.pi / rng.uniform(*_DRIFT_PERIODS_S, 6)).tolist()
        self._phases = rng.uniform(0.0, 2.0 * math.pi, 6).tolist()

    def sense(self, time_ns: int, tcp_z_m: float) -> Vector6:
        """Return the reading at a time. tcp_z_m: height of the fingertips, which the table pushes up."""
        if self._readings % self._every == 0:
            time_s, true = time_ns / NS_PER_S, carried_wrench(self._world, time_ns)
            waves = zip(true, self._bias, self._drift, self._rates, self._phases, strict=True)
            self._load = six(w + o + size * math.sin(rate * time_s + p) for w, o, size, rate, p in waves)
        self._readings += 1
        noise = self._noise[time_ns // _CYCLE_NS % _NOISE_CYCLES].tolist()
        push_n = max(self._world.layout.floor_z_m - tcp_z_m, 0.0) * FLOOR_STIFFNESS_N_M
        a, b, c, d, e, f = self._load
        seen = zip((a, b, c + push_n, d, e, f), noise, _STEPS, strict=True)
        shown = [round(round((value + n) / step) * step, 6) for value, n, step in seen]
        return six(map(sub, shown, self._zero))

    def zero(self, wrench: Vector6) -> None:
        """Subtract a reading from all later ones."""
        self._zero = six(map(add, self._zero, wrench))


def _six(rng: np.random.Generator, force_n: float, torque_nm: float) -> Vector6:
    return six(rng.normal(0.0, _spread(force_n, torque_nm)).tolist())


def _spread(force_n: float, torque_nm: float) -> tuple[float, ...]:
    return (force_n,) * 3 + (torque_nm,) * 3


_STEPS = _spread(STEP_N, STEP_NM)
