"""`rig benchmark reaction`: what counts as caught, and the same lift twice."""

from dataclasses import replace

import pytest

from protocols.reaction import ReactionKind
from rig.benchmark.reaction.benchmark import ReactionResult, as_json, reaction_table, run_reaction
from rig.benchmark.reaction.lifts import GRIPPER_PERIOD_S, ReactedLift, Told, as_late_as_real
from rig.config import BenchConfig
from rig.experiments.lift_attempt import TrialSettings
from rig.sessions.records import LiftOutcome
from rig.tactile.estimators import choose_estimator

CAUGHT = ReactedLift("t1", 1, LiftOutcome.CAUGHT, -2.0, (Told(0.01, 0.004, 6),), False, 9, False)


@pytest.mark.parametrize(
    ("change", "caught"),
    [
        ({}, True),
        ({"turn_deg": 5.5}, False),
        ({"turn_deg": None}, False),
        ({"told": ()}, False),
        ({"outcome": LiftOutcome.FALLEN}, False),
        ({"outcome": LiftOutcome.SLIPPED}, False),  # it was not lifted to the end, and could have been
        ({"outcome": LiftOutcome.SLIPPED, "holds_from": None}, True),
    ],
)
def test_caught_is_a_small_turn_at_the_height_that_friction_allows(
    change: dict[str, object], caught: bool
) -> None:
    assert replace(CAUGHT, **change).caught is caught  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def result(light_bench: BenchConfig) -> ReactionResult:
    settings = TrialSettings(light_bench, 0, choose_estimator("slip"), react=ReactionKind.TIGHTEN)
    return run_reaction(settings, ["t2"], 1, jobs=1)


def test_the_same_lift_slips_without_and_is_caught_with(result: ReactionResult) -> None:
    [(without, reacted)] = result.pairs
    assert without.slips
    assert not without.told
    assert reacted.caught
    assert reacted.would_hold
    assert not reacted.damaged
    assert abs(reacted.turn_deg or 99.0) < 5.0 < abs(without.turn_deg or 0.0)
    assert reacted.counts_added > 0


def test_the_table_and_the_json_say_what_was_found(result: ReactionResult) -> None:
    table = reaction_table(result)
    assert [row[0] for row in table.rows] == ["all", "t2"]
    assert table.rows[0][2:4] == ("1", "1")
    assert as_json(result)["simulated"] is True
    met = {limit.name.split(",")[0]: limit.met for limit in result.limits}
    assert met["share of slipping lifts caught"] is True
    assert met["share of lifts that hold and react all the same"] is None


def test_the_simulated_gripper_obeys_late_unless_its_bench_says_how_late(light_bench: BenchConfig) -> None:
    assert light_bench.gripper.period_s == 0.0
    assert as_late_as_real(light_bench).gripper.period_s == GRIPPER_PERIOD_S
    later = light_bench.gripper.model_copy(update={"period_s": 0.03})
    own = light_bench.model_copy(update={"gripper": later})
    assert as_late_as_real(own) is own
