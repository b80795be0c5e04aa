"""The dynamics of a grip: direction, rate and extent of the rotation; the load on the fingers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.world.force_torque import carried_wrench
from fakes.world.state import GripLoad, SlipDynamics, WorldState

DT_S = 0.002
LIFTED_M = 0.06
LIGHT = GripLoad(force_n=1.0, weight_n=0.6, friction=0.9, patch_radius_m=0.004, lever_m=0.05, reach_m=0.15)


def lifted(load: GripLoad, height_m: float, seed: int = 0) -> tuple[SlipDynamics, list[float]]:
    slip = SlipDynamics(np.random.default_rng(seed))
    angles = []
    for step in range(1500):
        slip.step(load, height_m * min(step / 750, 1.0), DT_S)
        angles.append(math.degrees(slip.angle_rad))
    return slip, angles


@given(st.integers(0, 1000), st.sampled_from([-0.05, 0.05]), st.floats(0.02, 0.07))
def test_object_turns_towards_the_heavy_side_until_the_support_angle(
    seed: int, lever_m: float, height_m: float
) -> None:
    load = GripLoad(1.0, 0.6, 0.9, 0.004, lever_m, 0.15)
    _, angles = lifted(load, height_m, seed)
    demand = math.degrees(math.asin(height_m / 0.15))
    assert math.copysign(1.0, angles[-1]) == math.copysign(1.0, lever_m)
    assert demand - 3.0 <= abs(angles[-1]) <= demand + 1e-9


@given(st.integers(0, 1000))
def test_slip_rate_is_limited_with_sticking_in_between(seed: int) -> None:
    _, angles = lifted(LIGHT, 0.06, seed)
    rates = np.abs(np.diff(angles)) / DT_S
    assert rates.max() <= 60.0 + 1e-6
    assert (rates[:750] < 1.0).mean() > 0.05


@pytest.mark.parametrize("lever_m", [0.05, -0.05])
def test_held_object_loads_the_fingers_with_its_weight_and_the_torque_of_it(lever_m: float) -> None:
    load = GripLoad(20.0, 1.0, friction=0.8, patch_radius_m=0.004, lever_m=lever_m, reach_m=0.1)
    state = WorldState(0, 20.0, 0.0, 0.0, 0.0, 0.0, loaded=1.0, held=True)
    world = SimpleNamespace(grip_at=lambda time_ns: (state, load))
    force, torque = np.reshape(carried_wrench(world, 0), (2, 3))  # type: ignore[arg-type]
    assert force == pytest.approx((0.0, 0.0, -1.0))
    assert torque == pytest.approx(np.cross((-lever_m, 0.0, 0.0), force))
