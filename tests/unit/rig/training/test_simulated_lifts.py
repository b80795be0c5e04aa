"""Simulated training lifts follow the protocol, are reproducible, and are seen from both sides."""

import numpy as np
import pytest

from rig.training.lifts import SIGHT_HZ, simulated_lifts

SIZE = (36, 48)


def test_simulated_lifts_follow_the_protocol_and_are_reproducible() -> None:
    first, second = (next(simulated_lifts(["7"], 1, 5, lambda *_: None)).wrist() for _ in range(2))
    assert first.states == second.states
    assert (first.turn_deg == second.turn_deg).all()
    assert first.rising.sum() == pytest.approx((1.5 + 1.2) * 30, abs=3)
    assert not first.turn_deg[~first.rising].any()
    assert 5.0 < abs(first.turn_deg[-1]) < 30.0
    pulled = np.array([s.wrench[2] for s in first.states])
    assert pulled[-20:].mean() < pulled[: -len(pulled) // 2].mean() - 0.1


def test_fingertips_measure_opposite_image_rotations() -> None:
    lift = next(simulated_lifts(["7"], 1, 5, lambda *_: None, SIGHT_HZ))
    views = list(lift.views(SIZE))
    angles = np.array([angle for *_, angle in views]).reshape(2, -1)
    assert angles[0] == pytest.approx(-angles[1], abs=1.5)
    assert np.ptp(angles[0]) > 5.0
    assert views[0][1].shape == (48, 36, 3)
