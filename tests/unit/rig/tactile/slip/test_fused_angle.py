"""The fusion of two trackers: weights, continuity, variance."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.tactile.slip.fused_angle import (
    MOST_RATE_RAD_S,
    FirstAnswer,
    Fused,
    FusedAngle,
    JointAngle,
)
from rig.tactile.slip.parameters import FUSION

PERIOD_S = 0.02
FIRST = FirstAnswer(0.0, 0.0, math.radians(1.0), 0.0, 0.0, texture_leads=False)
JOINT = JointAngle(0.0, 0.0, score=1.5, own_rad=math.radians(2.0), richness=1.0)


def fused(frames: list[tuple[FirstAnswer | None, JointAngle | None]]) -> list[Fused | None]:
    fusion = FusedAngle()
    return [fusion.update(i * PERIOD_S, first, joint) for i, (first, joint) in enumerate(frames)]


def turning(
    first_deg: float, joint_deg: float, texture_leads: bool, score: float = 1.5, frames: int = 60
) -> Fused:
    """Both trackers turn steadily, each to its own angle; return the last answer."""
    shares = [i / (frames - 1) for i in range(frames)]
    answers = fused(
        [
            (
                replace(FIRST, angle_rad=math.radians(first_deg * share), texture_leads=texture_leads),
                replace(JOINT, angle_rad=math.radians(joint_deg * share), score=score),
            )
            for share in shares
        ]
    )
    assert answers[-1] is not None
    return answers[-1]


angles = st.floats(-3.0, 3.0)
firsts = st.none() | st.builds(
    FirstAnswer, angles, st.just(0.0), st.floats(0.001, 1.0), st.just(0.0), st.just(0.0), st.booleans()
)
joints = st.none() | st.builds(
    JointAngle, angles, st.just(0.0), st.floats(0.0, 2.3), st.floats(0.0, 0.5), st.floats(0.0, 20.0)
)


def test_answer_of_the_joint_tracker_may_come_one_frame_late_while_the_slopes_lead() -> None:
    in_time, late = FusedAngle(), FusedAngle()
    for i in range(40):
        first = replace(FIRST, angle_rad=0.01 * i)
        joint = replace(JOINT, angle_rad=0.008 * i)
        expected = in_time.update(i * PERIOD_S, first, joint)
        answer = late.update(i * PERIOD_S, first, None)
        late.take_late(joint, first.angle_rad)
        assert expected is not None
        assert answer is not None
        assert answer.angle_rad == expected.angle_rad
    leading = replace(FIRST, angle_rad=0.4, texture_leads=True)
    after = [of.update(40 * PERIOD_S, leading, replace(JOINT, angle_rad=0.32)) for of in (in_time, late)]
    assert after[0] is not None
    assert after[1] is not None
    assert after[1].angle_rad == pytest.approx(after[0].angle_rad, abs=1e-3)


@given(st.lists(st.tuples(firsts, joints), min_size=2, max_size=30))
def test_angle_never_changes_faster_than_the_motion_prior_allows(
    frames: list[tuple[FirstAnswer | None, JointAngle | None]],
) -> None:
    known = [(i, answer) for i, answer in enumerate(fused(frames)) if answer is not None]
    for (i, before), (k, after) in pairwise(known):
        assert abs(after.angle_rad - before.angle_rad) <= MOST_RATE_RAD_S * PERIOD_S * (k - i) + 1e-9
        assert math.isfinite(after.variance)
        assert after.variance >= 0.0


def test_first_tracker_decides_while_the_slopes_lead() -> None:
    assert math.degrees(turning(30.0, 5.0, texture_leads=False).angle_rad) == pytest.approx(30.0)


def test_joint_tracker_decides_while_the_texture_leads() -> None:
    assert math.degrees(turning(5.0, 30.0, texture_leads=True).angle_rad) == pytest.approx(30.0, abs=0.1)


def test_joint_tracker_with_a_low_score_is_ignored() -> None:
    ignored = turning(5.0, 30.0, texture_leads=True, score=0.5 * FUSION.least_score)
    assert math.degrees(ignored.angle_rad) == pytest.approx(5.0)


def test_sigma_grows_with_the_gap_between_the_trackers() -> None:
    agreeing = turning(30.0, 30.0, texture_leads=True)
    apart = turning(10.0, 30.0, texture_leads=True)
    assert math.sqrt(apart.variance) > math.sqrt(agreeing.variance) + math.radians(3.0)


def test_sigma_is_that_of_the_first_tracker_while_the_slopes_lead() -> None:
    assert turning(30.0, 5.0, texture_leads=False).variance == pytest.approx(FIRST.sigma_rad**2)


def test_shape_uncertainty_counts_for_both_trackers() -> None:
    hidden = replace(FIRST, shape_doubt=math.radians(10.0) ** 2, texture_leads=True)
    answers = fused([(hidden, JOINT)] * 60)
    assert answers[-1] is not None
    assert math.sqrt(answers[-1].variance) > math.radians(9.0)


def test_wrong_turn_of_the_joint_tracker_before_the_texture_leads_is_forgotten() -> None:
    wrong = replace(JOINT, angle_rad=math.radians(20.0))
    frames: list[tuple[FirstAnswer | None, JointAngle | None]] = [(FIRST, JOINT)]
    frames += [(FIRST, wrong)] * 200
    frames += [(replace(FIRST, texture_leads=True), wrong)] * 100
    answers = fused(frames)
    assert answers[-1] is not None
    assert math.degrees(answers[-1].angle_rad) == pytest.approx(0.0, abs=0.1)


def test_joint_tracker_bridges_a_lost_first_tracker() -> None:
    turns = [math.radians(i) for i in range(40)]
    frames: list[tuple[FirstAnswer | None, JointAngle | None]] = [
        (None if 10 <= i < 30 else FIRST, replace(JOINT, angle_rad=turn)) for i, turn in enumerate(turns)
    ]
    answers = fused(frames)
    assert answers[29] is not None
    bridged = answers[30]
    assert bridged is not None
    assert bridged.angle_rad == pytest.approx(
        answers[29].angle_rad + math.radians(1.0), abs=math.radians(1.0)
    )


def test_joint_tracker_alone_needs_a_score() -> None:
    assert fused([(None, replace(JOINT, score=0.5 * FUSION.least_score))]) == [None]
    assert fused([(None, None)]) == [None]
