"""The grip's dynamics: it turns the way gravity says, at a bounded rate, and only as far as lifted."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fakes.world.slip import PAD_M, GripLoad, SlipDynamics

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


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.sampled_from([-0.05, 0.05]), st.floats(0.02, 0.07))
def test_turns_towards_the_heavy_side_and_stops_where_the_support_does(
    seed: int, lever_m: float, height_m: float
) -> None:
    load = GripLoad(1.0, 0.6, 0.9, 0.004, lever_m, 0.15)
    _, angles = lifted(load, height_m, seed)
    demand = math.degrees(math.asin(height_m / 0.15))
    assert math.copysign(1.0, angles[-1]) == math.copysign(1.0, lever_m)
    assert demand - 3.0 <= abs(angles[-1]) <= demand + 1e-9


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000))
def test_slips_at_sixty_degrees_per_second_at_most_and_sticks_in_between(seed: int) -> None:
    _, angles = lifted(LIGHT, 0.06, seed)
    rates = np.abs(np.diff(angles)) / DT_S
    assert rates.max() <= 60.0 + 1e-6
    assert (rates[:750] < 1.0).mean() > 0.05


def test_a_strong_grip_holds() -> None:
    strong = GripLoad(15.0, 0.3, 1.0, 0.004, 0.02, 0.15)
    slip, angles = lifted(strong, 0.08)
    assert abs(angles[-1]) < 0.5
    assert not slip.fallen


def test_a_heavy_object_falls() -> None:
    heavy = GripLoad(0.5, 5.0, 0.8, 0.004, 0.05, 0.15)
    slip, _ = lifted(heavy, 0.06)
    assert slip.fallen
    assert slip.slide_m == pytest.approx(PAD_M, rel=0.01)


def test_gel_torsion_lags_then_relaxes() -> None:
    slip = SlipDynamics(np.random.default_rng(3))
    wound = []
    for step in range(3000):
        slip.step(LIGHT, 0.06 * min(step / 750, 1.0), DT_S)
        wound.append(math.degrees(slip.torsion_rad))
    assert 0.2 < max(wound) < 1.6
    assert abs(wound[-1]) < 0.2 * max(wound)


TIGHT = replace(LIGHT, force_n=12.0)


def stepped(slip: SlipDynamics, load: GripLoad, height_m: float, duration_s: float) -> None:
    for _ in range(round(duration_s / DT_S)):
        slip.step(load, height_m, DT_S)


def slipped() -> SlipDynamics:
    """A grip that has let its object turn by about 11 degrees, and not yet as far as it will."""
    slip = SlipDynamics(np.random.default_rng(0))
    while abs(math.degrees(slip.angle_rad)) < 11.0:
        slip.step(LIGHT, LIFTED_M, DT_S)
    return slip


def test_a_grip_that_is_tightened_keeps_the_turn_it_has() -> None:
    slip = slipped()
    turned = slip.angle_rad
    stepped(slip, TIGHT, LIFTED_M, DT_S)
    assert slip.angle_rad == pytest.approx(turned, abs=1e-12)
    stepped(slip, TIGHT, LIFTED_M, 2.0)
    assert slip.angle_rad == pytest.approx(turned, abs=1e-12)


def test_a_tightened_grip_stops_the_turn_while_the_lift_goes_on() -> None:
    slip = slipped()
    turned = slip.angle_rad
    for step in range(500):
        slip.step(TIGHT, LIFTED_M + 0.03 * step / 500, DT_S)
    assert slip.angle_rad == pytest.approx(turned, abs=1e-12)


def test_the_gel_relaxes_in_a_tightened_grip() -> None:
    slip = slipped()
    wound = slip.torsion_rad
    stepped(slip, TIGHT, LIFTED_M, 1.6)
    assert abs(wound) > math.radians(0.3)
    assert 0.0 < abs(slip.torsion_rad) < 0.2 * abs(wound)


def test_a_grip_that_loosens_again_slips_on_to_where_the_support_holds() -> None:
    slip = slipped()
    stepped(slip, TIGHT, LIFTED_M, 0.5)
    turned = slip.angle_rad
    stepped(slip, LIGHT, LIFTED_M, 2.0)
    demand = math.asin(LIFTED_M / LIGHT.reach_m)
    assert slip.angle_rad > turned + math.radians(5.0)
    assert demand - math.radians(3.0) <= slip.angle_rad <= demand + 1e-9


def test_an_object_set_down_in_a_tight_grip_is_turned_back() -> None:
    slip = slipped()
    stepped(slip, TIGHT, 0.0, DT_S)
    assert slip.angle_rad == 0.0


def test_a_grip_that_holds_from_the_start_gives_way_only_as_the_weight_comes_onto_it() -> None:
    slip, angles = lifted(TIGHT, LIFTED_M)
    assert angles[:94] == pytest.approx([0.3 * min(0.06 * step / 750 / 0.01, 1.0) for step in range(94)])
    assert math.degrees(slip.angle_rad) == pytest.approx(0.3)
