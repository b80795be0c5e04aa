"""Trapezoidal travel: starts at rest, never runs back, ends exactly, stays within its limits."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import NS_PER_S
from fakes.world.motion import TrapezoidProfile

travels = st.builds(
    TrapezoidProfile,
    start_ns=st.integers(0, 10**10),
    distance=st.floats(1e-4, 1.0),
    speed=st.floats(0.01, 1.0),
    acceleration=st.floats(0.1, 5.0),
)


@given(travels)
def test_runs_from_nothing_to_all_without_turning_back(travel: TrapezoidProfile) -> None:
    steps = [travel.start_ns + round(travel.duration_s * NS_PER_S * i / 50) for i in range(52)]
    fractions = [travel.fraction_at(t) for t in steps]
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert all(a <= b + 1e-12 for a, b in pairwise(fractions))


@given(travels, st.floats(0.0, 1.5))
def test_a_cut_run_stays_where_it_was_cut(travel: TrapezoidProfile, share: float) -> None:
    cut_ns = travel.start_ns + round(share * travel.duration_s * NS_PER_S)
    cut = replace(travel, stop_fraction=travel.fraction_at(cut_ns))
    assert cut.done_at(cut_ns)
    assert cut.fraction_at(cut_ns + 10 * NS_PER_S) == travel.fraction_at(cut_ns)


@given(travels, st.floats(0.0, 1.2), st.floats(1.0, 20.0))
def test_braked_travel_continues_for_its_braking_distance(
    travel: TrapezoidProfile, share: float, deceleration: float
) -> None:
    told_ns = travel.start_ns + round(share * travel.duration_s * NS_PER_S)
    braked = travel.braked_at(told_ns, deceleration)
    dt_ns = 1_000_000
    before, after = (travel.fraction_at(t) * travel.distance for t in (told_ns - dt_ns, told_ns + dt_ns))
    speed = (after - before) / (2 * dt_ns) * NS_PER_S
    hardest = max(deceleration, travel.acceleration)
    way = (braked.fraction_at(told_ns + 10 * NS_PER_S) - travel.fraction_at(told_ns)) * travel.distance
    assert way <= travel.speed**2 / (2 * hardest) + 1e-9
    assert way == pytest.approx(speed**2 / (2 * hardest), rel=0.2, abs=2e-3 * travel.speed)
    assert braked.done_at(told_ns + round(travel.speed / hardest * NS_PER_S) + 1)
    assert braked.fraction_at(told_ns + 10 * NS_PER_S) <= 1.0 + 1e-9
    assert braked.braked_at(told_ns + dt_ns, deceleration) == braked
