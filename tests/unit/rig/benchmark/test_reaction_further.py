"""`rig benchmark reaction --full`: objects at rest, faults, lifts that just hold."""

from dataclasses import replace

import numpy as np

from drivers.types import Pose
from rig.benchmark.reaction.lifts import ReactedLift
from rig.benchmark.reaction.rest import Rest, at_rest, false_reactions
from rig.benchmark.reaction.study import SPARE_STEPS, judge_faults, just_holding
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.fault_lifts import IN_REACTION, FaultyLift, row_of
from rig.benchmark.wire.world import Stage, StageWatch
from rig.config import BenchConfig
from rig.experiments.lift_plan import LiftTask, TrialSettings, plan_lift
from rig.lift.fusion import TipAnswer
from rig.sessions.records import LiftOutcome
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State

FRAME_NS = 16_666_667
HOURS = 0.05


def rest(noise_deg: float, noise_deg_s: float, worse: float = 1.0) -> Rest:
    """Two fingertips at rest. worse: factor of the noise after it was learnt."""
    rng = np.random.default_rng(0)

    def answers(frames: int, scale: float) -> dict[str, list[TipAnswer]]:
        return {
            serial: [
                answer(2 * i + n, *(scale * rng.normal(0.0, (noise_deg, noise_deg_s)))) for i in range(frames)
            ]
            for n, serial in enumerate(("a", "b"))
        }

    return Rest(answers(48, 1.0), answers(360, worse))


def answer(half: int, angle_deg: float, rate_deg_s: float) -> TipAnswer:
    sample = SlipSample(half * FRAME_NS // 2, State.TRACKING, angle_deg, None)
    return TipAnswer(sample, float(angle_deg), None, float(rate_deg_s))


def test_false_reactions_at_rest_with_drift_stay_below_accepted_rate() -> None:
    assert all(row.met for row in at_rest([rest(0.05, 1.0)], HOURS))


def test_increased_noise_causes_false_reactions() -> None:
    assert false_reactions([rest(0.3, 6.0, worse=4.0)], HOURS, 10.0) > 10


def test_unnoticed_fault_in_a_reaction_misses_the_limit() -> None:
    """A lift with a reaction continues long after it first stood; a lift that only holds may be over."""
    case = CASES[0]
    held = FaultyLift(case, IN_REACTION, stage=Stage.HOLD, injected_ns=1, recovered=True)
    assert held.passed
    assert not replace(held, reacts=True).passed
    row = judge_faults([row_of(1, replace(held, reacts=True))])
    assert row.met is False
    assert case.name in row.name


def test_stage_in_reaction_begins_when_the_lift_first_stands() -> None:
    watch = StageWatch(grasp_m=0.05)
    seen = [(0.3, True, False), (0.05, False, False), (0.06, True, True), (0.06, False, True)]
    stages = [watch.see({"tool_m": (0.0, 0.0, z), "tool_moving": m, "held": h}) for z, m, h in seen]
    assert stages[-2:] == [Stage.LIFT, IN_REACTION.stage]


def test_given_grip_replaces_the_drawn_one(light_bench: BenchConfig) -> None:
    settings = TrialSettings(light_bench, 0, choose_estimator("slip"))
    table = Pose(light_bench.table.position_m)
    drawn = plan_lift(settings, LiftTask(1, "t1", 1), table)
    given = plan_lift(settings, LiftTask(1, "t1", 1, grip_steps=40), table)
    assert given == replace(drawn, grip_steps=40)


def test_lifts_that_can_hold_are_repeated_with_a_grip_that_just_holds() -> None:
    held, never = (
        ReactedLift("t1", 1, LiftOutcome.SLIPPED, 12.0, (), False, grip, False) for grip in (9, None)
    )
    lifted = {LiftTask(1, "t1", 1): held, LiftTask(2, "t1", 2): never}
    assert just_holding(lifted) == [LiftTask(1, "t1", 1, grip_steps=9 + SPARE_STEPS)]
