"""Simulated training lifts follow the protocol, are reproducible, and are seen from both sides."""

import numpy as np
import pytest

from rig.training.lifts import AT_REST, SIGHT_HZ, simulated_lifts

SIZE = (36, 48)


@pytest.mark.heavy
def test_simulated_lifts_follow_the_protocol_and_are_reproducible() -> None:
    first, second = (next(simulated_lifts(["7"], 1, 5, lambda *_: None)).steps() for _ in range(2))
    np.testing.assert_array_equal(first, second)
    turn_deg, rising = first[:, 6], first[:, 7] == 1.0
    assert rising.sum() == pytest.approx((1.5 + 1.2) * 30, abs=3)
    assert set(first[~rising, 7]) == {np.float32(AT_REST)}
    assert not turn_deg[~rising].any()
    assert 5.0 < abs(turn_deg[-1]) < 30.0
    assert first[-20:, 2].mean() < first[: len(first) // 2, 2].mean() - 0.1


@pytest.mark.heavy
def test_fingertips_measure_opposite_image_rotations() -> None:
    lift = next(simulated_lifts(["7"], 1, 5, lambda *_: None, SIGHT_HZ))
    views = list(lift.views(SIZE))
    angles = np.array([angle for *_, angle in views]).reshape(2, -1)
    assert angles[0] == pytest.approx(-angles[1], abs=1.5)
    assert np.ptp(angles[0]) > 5.0
    assert views[0][1].shape == (48, 36, 3)
