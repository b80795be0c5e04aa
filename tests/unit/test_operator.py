"""The person at the bench: asked before anything moves, and no oftener than needed."""

import pytest

from drivers.errors import OperatorStopError
from rig.assembly import ConsoleOperator
from rig.config import BenchConfig, load_bench
from rig.trial import bench_operator, trial_settings


def real_bench() -> BenchConfig:
    """The simulated bench's file with real drivers named; none is ever built here."""
    config = load_bench("fake").model_dump()
    config["arm"]["driver"], config["gripper"]["driver"] = "ur5e", "robotiq_3f"
    config["camera"]["driver"] = "camera"
    for tactile in config["tactile"]:
        tactile["driver"] = "digit"
    return BenchConfig.model_validate(config)


def test_a_real_bench_shows_the_plan_and_asks_before_it_begins() -> None:
    asked: list[str] = []

    def agree(question: str) -> bool:
        asked.append(question)
        return True

    settings = trial_settings(real_bench(), 0, None, 2)
    assert bench_operator(settings, ["t1"], 2, agree) is not None
    assert len(asked) == 1
    for part in ("m/s", "counts past contact", "lift 0.", "t1/1", "t1/2", "Begin?"):
        assert part in asked[0]


def test_without_agreement_nothing_begins() -> None:
    settings = trial_settings(real_bench(), 0, None, 2)
    with pytest.raises(OperatorStopError, match="nothing was moved"):
        bench_operator(settings, ["t1"], 1, lambda _: False)


def test_a_simulated_bench_asks_nobody() -> None:
    settings = trial_settings(load_bench("fake"), 0, None, 2)
    assert bench_operator(settings, ["t1"], 1, lambda _: False) is None


def test_objects_are_asked_for_when_they_change_and_after_a_fall() -> None:
    asked: list[str] = []
    operator = ConsoleOperator(lambda question: not asked.append(question))
    operator.place("t1", "wrench")
    operator.place("t1", "wrench")
    operator.displaced()
    operator.place("t1", "wrench")
    operator.place("7", "spam")
    assert [question.split()[2] for question in asked] == ["t1", "t1", "7"]
