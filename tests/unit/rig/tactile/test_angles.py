"""The series type: conversion from samples, selection, and values at other times."""

import numpy as np
import pytest

from rig.tactile.angles import FUSED, Angles
from rig.tactile.sample import SlipSample, State

MS = 1_000_000
LATE_NS = 1_700_000_000 * 1000 * MS
"""A clock that counts from 1970: as a float in s it would be off by 0.2 us."""


def samples() -> list[SlipSample]:
    tracking = State.TRACKING
    return [
        SlipSample(LATE_NS + 20 * MS, tracking, 2.0, 0.2, contact_area_px=60.0),
        SlipSample(LATE_NS + 10 * MS + 1, tracking, 1.0, None, contact_area_px=50.0),
        SlipSample(LATE_NS + 30 * MS, State.LOST),
    ]


def test_samples_become_columns_in_order_of_time() -> None:
    angles = Angles.of(samples(), "D1", LATE_NS)
    assert angles.time_ns.tolist() == [LATE_NS + 10 * MS + 1, LATE_NS + 20 * MS, LATE_NS + 30 * MS]
    np.testing.assert_array_equal(angles.angle_deg, [1.0, 2.0, np.nan])
    np.testing.assert_array_equal(angles.sigma_deg, [np.nan, 0.2, np.nan])
    assert angles.states == ("tracking", "tracking", "lost")
    assert angles.contact_area_px.tolist() == [50.0, 60.0, 0.0]
    assert Angles.of(samples(), FUSED).contact_area_px.size == 0


def test_selected_samples_keep_all_columns() -> None:
    angles = Angles.of(samples(), "D1", LATE_NS)
    known = angles.known
    assert (len(known), known.states, known.contact_area_px.size) == (2, ("tracking",) * 2, 2)
    inside = angles.between(LATE_NS + 20 * MS, LATE_NS + 30 * MS)
    assert (inside.angle_deg.tolist(), inside.source, inside.zero_ns) == ([2.0], "D1", LATE_NS)


def test_rotation_since_a_zero_has_the_objects_sign() -> None:
    zero = SlipSample(0, State.TRACKING, 1.0, 0.5, unseen_deg=0.4)
    sample = SlipSample(1, State.TRACKING, 4.0, 0.5, unseen_deg=0.4, rate_deg_s=2.0)
    turned = sample.turned(-1, 1.0, zero)
    assert (turned.angle_deg, turned.rate_deg_s) == (-3.0, -2.0)
    assert turned.sigma_deg == pytest.approx(0.3), "rotations before both cancel"
    assert sample.turned(1, None, None).angle_deg is None


@pytest.mark.parametrize("zero_ns", [0, LATE_NS])
def test_angle_is_interpolated_over_short_gaps_only(zero_ns: int) -> None:
    series = Angles(np.array([0.0, 0.05, 0.101, 0.111, 0.121]), [1.0, 3.0, 5.0, np.nan, 7.0], zero_ns=zero_ns)
    cases = {-1: None, 0: 1.0, 25: 2.0, 50: 3.0, 60: None, 101: 5.0, 111: 6.0, 121: 7.0, 122: None}
    for time_ms, expected in cases.items():
        found = series.at_ns(zero_ns + time_ms * MS)
        assert found == (None if expected is None else pytest.approx(expected)), time_ms
    assert Angles(np.empty(0), np.empty(0)).at_ns(zero_ns) is None
