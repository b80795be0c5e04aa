"""Fusion of two fingertips into one angle."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.lift.object_angle import MAX_SKEW_NS, Disagreement, FusedAngles, fuse
from rig.tactile.sample import SlipSample, State

angles = st.floats(-180.0, 180.0)
sigmas = st.floats(0.01, 10.0)


def answer(angle: float | None, sigma: float | None = None, time_ns: int = 0) -> SlipSample:
    state = State.TRACKING if angle is not None else State.UNOBSERVABLE
    return SlipSample(time_ns, state, angle, sigma)


@given(angles, sigmas, angles, sigmas)
def test_fused_angle_lies_between_and_its_sigma_is_not_too_small(
    a: float, sa: float, b: float, sb: float
) -> None:
    fused = fuse(answer(a, sa), [answer(b, sb)])
    assert fused.angle_deg is not None
    assert fused.sigma_deg is not None
    assert min(a, b) - 1e-6 <= fused.angle_deg <= max(a, b) + 1e-6
    assert math.hypot(1 / sa, 1 / sb) ** -1 <= fused.sigma_deg * (1.0 + 1e-9)


@given(st.floats(-30.0, 30.0), st.floats(0.1, 2.0), st.floats(0.5, 2.0), st.floats(-1.0, 1.0))
def test_more_certain_of_two_agreeing_fingertips_has_more_weight(
    a: float, sa: float, times: float, gap: float
) -> None:
    sb = times * sa
    fused = fuse(answer(a, sa), [answer(a + gap * min(sa, sb), sb)])
    assert fused.angle_deg is not None
    assert fused.sigma_deg is not None
    # Their errors are correlated: a second answer helps less than an independent one would.
    assert fused.sigma_deg <= 1.2 * min(sa, sb)
    middle_deg = a + 0.5 * gap * min(sa, sb)
    surer_deg = a if sa < sb else a + gap * min(sa, sb)
    assert abs(fused.angle_deg - surer_deg) <= abs(middle_deg - surer_deg) + 1e-6


@pytest.mark.parametrize("turn_deg", [12.0, -25.0])
def test_stuck_fingertip_does_not_affect_the_fused_angle(turn_deg: float) -> None:
    fused = fuse(answer(0.2, 0.5), [answer(turn_deg, 1.0)])
    assert fused.angle_deg == turn_deg
    assert fused.sigma_deg is not None
    assert fused.sigma_deg > 1.2  # it may be the other way round
    assert fused.disagreement is Disagreement.ONE_PAD_SLIPS


def test_fused_rate_uses_only_the_accepted_fingertips() -> None:
    stuck = replace(answer(0.0, 0.5), rate_deg_s=0.1)
    assert fuse(stuck, [replace(answer(20.0, 1.0), rate_deg_s=50.0)]).rate_deg_s == 50.0
    assert fuse(stuck, [replace(answer(0.5, 0.5), rate_deg_s=0.3)]).rate_deg_s == pytest.approx(0.2)


def moving(angle: float | None, sigma: float, rate_deg_s: float, time_ns: int = 0) -> SlipSample:
    return replace(answer(angle, sigma, time_ns), rate_deg_s=rate_deg_s)


@pytest.mark.parametrize(
    ("now", "other", "before", "expected"),
    [
        (answer(None), answer(3.0), None, 3.0),
        (answer(None), answer(None), None, None),
        (answer(1.0, time_ns=MAX_SKEW_NS + 1), answer(9.0), None, 1.0),
        (answer(None, time_ns=10_000_000), moving(5.0, 0.1, 60.0), None, pytest.approx(5.6)),
        (answer(20.0, 1.0, 100_000_000), answer(19.2, 1.0, 50_000_000), answer(18.0), pytest.approx(20.1)),
        (answer(12.0, 20.0, 16_000_000), moving(15.0, 1.0, 0.0, 8_000_000), answer(2.0),
         pytest.approx(15.0, abs=0.1)),
    ],
    ids=["one angle", "no angle", "too old", "by its rate", "10 frames per second", "noisy newest"],
)  # fmt: skip
def test_answers_are_extrapolated_to_the_newest_time_if_recent(
    now: SlipSample, other: SlipSample, before: SlipSample | None, expected: object
) -> None:
    assert fuse(now, [other], before).angle_deg == expected


def test_state_is_kept_without_an_angle() -> None:
    assert fuse(answer(None), []).state is State.UNOBSERVABLE


@pytest.mark.parametrize(
    ("first", "second", "sigma", "expected"),
    [
        (10.0, 10.5, 0.2, None),
        (10.0, 13.0, 0.2, Disagreement.TILT),
        (10.0, 1.0, 0.2, Disagreement.ONE_PAD_SLIPS),
        (10.0, -10.0, 0.2, Disagreement.ONE_PAD_SLIPS),
        (10.0, 1.0, 3.0, None),
    ],
)
def test_rotations_that_differ_by_more_than_their_sigma_are_a_disagreement(
    first: float, second: float, sigma: float, expected: Disagreement | None
) -> None:
    assert fuse(answer(first, sigma), [answer(second, sigma)]).disagreement is expected


@given(angles, angles, st.integers(0, 200_000_000))
def test_fused_angle_turns_no_faster_than_an_object_in_a_gripper(a: float, b: float, later_ns: int) -> None:
    fusion = FusedAngles()
    fusion.update(answer(a, 1.0), [])
    fused = fusion.update(answer(b, 1.0, later_ns), [])
    assert fused.angle_deg is not None
    assert fused.sigma_deg is not None
    assert abs(fused.angle_deg - a) <= 200.0 * later_ns / 1e9 + 1e-9
    assert fused.sigma_deg == pytest.approx(math.hypot(1.0, b - fused.angle_deg))


def test_angle_may_jump_without_sigma_or_to_another_zero() -> None:
    for sigma in (None, 1.0):
        fusion = FusedAngles()
        fusion.update(answer(0.0, sigma), [])
        if sigma is not None:
            fusion.restart()
        assert fusion.update(answer(20.0, sigma), []).angle_deg == 20.0
