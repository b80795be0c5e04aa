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


def test_both_fingertips_count_at_ten_frames_per_second() -> None:
    now = answer(20.0, 1.0, time_ns=100_000_000)
    fused = fuse(now, [answer(19.2, 1.0, time_ns=50_000_000)], answer(18.0))
    assert fused.angle_deg == pytest.approx(20.1)


def test_one_fingertip_with_an_angle_is_enough() -> None:
    assert fuse(answer(None), [answer(3.0)]).angle_deg == 3.0
    assert fuse(answer(None), [answer(None)]).angle_deg is None
    assert fuse(answer(None), []).state is State.UNOBSERVABLE


def test_old_answer_is_not_fused() -> None:
    fused = fuse(answer(1.0, time_ns=MAX_SKEW_NS + 1), [answer(9.0)])
    assert fused.angle_deg == 1.0


def test_older_answer_is_extrapolated_to_the_newer_time() -> None:
    moving = replace(answer(5.0, 0.1), rate_deg_s=60.0)
    fused = fuse(answer(None, time_ns=10_000_000), [moving])
    assert fused.angle_deg == pytest.approx(5.6)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (10.0, 10.5, None),
        (10.0, 13.0, Disagreement.TILT),
        (10.0, 1.0, Disagreement.ONE_PAD_SLIPS),
        (10.0, -10.0, Disagreement.ONE_PAD_SLIPS),
    ],
)
def test_different_rotations_are_reported_as_disagreement(
    first: float, second: float, expected: Disagreement | None
) -> None:
    assert fuse(answer(first, 0.2), [answer(second, 0.2)]).disagreement is expected


def test_uncertain_fingertips_are_not_reported_as_disagreeing() -> None:
    assert fuse(answer(10.0, 3.0), [answer(1.0, 3.0)]).disagreement is None


def test_noise_of_an_uncertain_fingertip_does_not_change_the_fused_angle() -> None:
    unsure = answer(12.0, 20.0, time_ns=16_000_000)
    fused = fuse(unsure, [replace(answer(15.0, 1.0, time_ns=8_000_000), rate_deg_s=0.0)], answer(2.0))
    assert fused.angle_deg == pytest.approx(15.0, abs=0.1)


@given(angles, angles, st.integers(0, 200_000_000))
def test_fused_angle_turns_no_faster_than_an_object_in_a_gripper(a: float, b: float, later_ns: int) -> None:
    fusion = FusedAngles()
    fusion.update(answer(a, 1.0), [])
    fused = fusion.update(answer(b, 1.0, later_ns), [])
    assert fused.angle_deg is not None
    assert fused.sigma_deg is not None
    assert abs(fused.angle_deg - a) <= 200.0 * later_ns / 1e9 + 1e-9
    assert fused.sigma_deg == pytest.approx(math.hypot(1.0, b - fused.angle_deg))


def test_answers_without_sigma_may_jump() -> None:
    fusion = FusedAngles()
    fusion.update(answer(0.0), [])
    assert fusion.update(answer(20.0), []).angle_deg == 20.0


def test_angle_may_jump_to_another_zero() -> None:
    fusion = FusedAngles()
    fusion.update(answer(0.0, 1.0), [])
    fusion.restart()
    assert fusion.update(answer(20.0, 1.0), []).angle_deg == 20.0
