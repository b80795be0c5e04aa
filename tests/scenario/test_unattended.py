"""Campaigns without a person at the bench: only a feeder that the bench file names places objects."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from drivers.bench import Bench
from drivers.errors import OperatorStopError
from protocols.grasps import find_grasp_file
from protocols.operator import Operator
from rig.bench.assembly import build_bench
from rig.bench.operators import ConsoleOperator
from rig.bench.source import BenchSource
from rig.config import BenchConfig
from rig.experiments import lift_attempt
from rig.experiments.lift_plan import LiftPlan, TrialSettings, plan_lift
from rig.experiments.pose_attempt import RecordSettings
from rig.experiments.record import run_record
from rig.experiments.trial import run_trial
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_lifts, read_poses
from rig.tactile.estimators import choose_estimator


@dataclass
class Attended(BenchSource):
    """Simulated benches with a person who agreed beforehand, as with --yes.

    answer: to each question at the bench; without a terminal it is no. object_id: placed in the world; by
    default that of the lift. asked: the questions.
    """

    config: BenchConfig
    answer: bool = False
    feeder: str | None = None
    object_id: str = ""
    asked: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.person = ConsoleOperator(lambda q: self.asked.append(q) or self.answer, agreed=True)
        self.person.feeder = self.feeder

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        bench, world = build_bench(self.config, seed, lift, attempt)
        world.place(self.object_id or lift.split("/")[0], "")
        with bench.connected():
            yield bench, self.person

    def displaced(self) -> None:
        self.person.displaced()


def run(folder: Path, benches: Attended, objects: list[str], lifts: int, resume: bool = False) -> None:
    settings = TrialSettings(benches.config, 0, choose_estimator("pca"))
    run_trial(folder, settings, objects, lifts, benches=benches, resume=resume)


def falling(*of: object) -> LiftPlan:
    """A plan whose grip is too loose."""
    return replace(plan_lift(*of), grip_steps=2)  # type: ignore[arg-type]


def test_only_the_next_object_needs_a_person_and_the_campaign_can_be_resumed(
    tmp_path: Path, light_bench: BenchConfig
) -> None:
    """Between the lifts of one object no question is asked, because it is set down in its place."""
    alone = Attended(light_bench)
    with pytest.raises(OperatorStopError) as stopped:
        run(tmp_path / "s", alone, ["t1", "t2"], 2)
    assert [(row.object, row.accepted) for row in read_lifts(tmp_path / "s")] == [("t1", True)] * 2
    assert alone.asked == [
        "Place object t2 (toothbrush) on its mark: object t1 (wrench) may still be there. Ready?"
    ]
    assert str(stopped.value) == (
        "stopped: object t1 (wrench) may still be there: a person has to place object t2 (toothbrush), or a "
        "feeder named in the bench file"
    )
    again = Attended(light_bench, answer=True)
    run(tmp_path / "s", again, ["t1", "t2"], 2, resume=True)
    assert [row.object for row in read_lifts(tmp_path / "s")] == ["t1", "t1", "t2", "t2"]


def test_fallen_object_needs_a_person(
    tmp_path: Path, light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lift_attempt, "plan_lift", falling)
    alone = Attended(light_bench)
    with pytest.raises(OperatorStopError, match="the last object fell or may lie anywhere: a person has to"):
        run(tmp_path / "s", alone, ["t1"], 2)
    (row,) = read_lifts(tmp_path / "s")
    assert row.outcome is LiftOutcome.FALLEN
    person = Attended(light_bench, answer=True)
    run(tmp_path / "p", person, ["t1"], 2)
    assert person.asked == [
        "Place object t1 (wrench) on its mark: the last object fell or may lie anywhere. Ready?"
    ]


def test_fault_needs_a_person(tmp_path: Path, light_bench: BenchConfig) -> None:
    fault = {"device": "gripper", "kind": "blocked", "at_s": 5.5}
    bench = BenchConfig.model_validate({**light_bench.model_dump(), "faults": [fault]})
    alone = Attended(bench)
    with pytest.raises(OperatorStopError, match="a person has to place"):
        run(tmp_path / "s", alone, ["t1"], 1)
    assert [row.outcome for row in read_lifts(tmp_path / "s")] == [LiftOutcome.FAULT]


def test_named_feeder_places_objects_and_is_written_into_the_log(
    tmp_path: Path, light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lift_attempt, "plan_lift", falling)
    fed = Attended(light_bench, feeder="magazine 2")
    run(tmp_path / "s", fed, ["t1", "t2"], 2)
    assert fed.asked == []
    assert len(read_lifts(tmp_path / "s")) == 4
    log = (tmp_path / "s" / "log.txt").read_text()
    assert log.count("object t1 (wrench) was placed by the feeder 'magazine 2'") == 2, "it fell"
    assert log.count("object t2 (toothbrush) was placed by the feeder 'magazine 2'") == 1


def test_recording_needs_a_person_after_a_fault(tmp_path: Path, light_bench: BenchConfig) -> None:
    fault = {"device": "gripper", "kind": "blocked", "at_s": 4.0}
    bench = BenchConfig.model_validate({**light_bench.model_dump(), "faults": [fault]})
    alone = Attended(bench, object_id="7")
    settings = RecordSettings(bench, 0, find_grasp_file("7"), 2, 8)
    with pytest.raises(OperatorStopError, match="a person has to place object 7"):
        run_record(tmp_path / "s", settings, benches=alone)
    assert [row.accepted for row in read_poses(tmp_path / "s")] == [False]
