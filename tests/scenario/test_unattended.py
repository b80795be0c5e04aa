"""Campaigns without a person at the bench: only a feeder that the bench file names places objects."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
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
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.record import RecordSettings, run_record
from rig.experiments.trial import run_trial
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_lifts, read_poses
from rig.tactile.estimators import choose_estimator
from support.quick_lifts import quick_lifts


@dataclass
class Attended(BenchSource):
    """Simulated benches with a person who agreed beforehand, as with --yes.

    answer: to each question at the bench; without a terminal it is no. object_id: placed in the world; by
    default that of the lift. asked: the questions. begun: the names of the lifts and poses.
    """

    config: BenchConfig
    answer: bool = False
    feeder: str | None = None
    object_id: str = ""
    asked: list[str] = field(default_factory=list)
    begun: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.person = ConsoleOperator(lambda q: self.asked.append(q) or self.answer, agreed=True)
        self.person.feeder = self.feeder

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        self.begun.append(lift)
        bench, world = build_bench(self.config, seed, lift, attempt)
        world.place(self.object_id or lift.split("/")[0], "")
        with bench.connection():
            yield bench, self.person

    def note_displaced(self) -> None:
        self.person.note_displaced()

    def place_first(self, object_id: str, why: str) -> None:
        if why:
            self.person.note_displaced(why)
            self.person.place(object_id, find_grasp_file(object_id).name)


def run(folder: Path, benches: Attended, objects: list[str], lifts: int, resume: bool = False) -> None:
    settings = TrialSettings(benches.config, 0, choose_estimator("pca"))
    run_trial(folder, settings, objects, lifts, benches=benches, resume=resume)


def refused_again(folder: Path, config: BenchConfig, objects: list[str], lifts: int) -> Attended:
    """Resume twice with --yes and without a terminal, as a loop in a shell does; nothing may begin."""
    alone = Attended(config)
    for _ in range(2):
        alone.asked.clear()
        with pytest.raises(
            OperatorStopError, match=r"a person has to place object t\d .*: run this at a ter"
        ):
            run(folder, alone, objects, lifts, resume=True)
    assert alone.begun == []
    return alone


@pytest.fixture(autouse=True)
def lifts_without_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_lifts(monkeypatch)


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
        "stopped: object t1 (wrench) may still be there: a person has to place object t2 (toothbrush): run "
        "this at a terminal, or name a feeder in the bench file (feeder in [table])"
    )
    alone = refused_again(tmp_path / "s", light_bench, ["t1", "t2"], 2)
    assert alone.asked == ["Place object t2 (toothbrush) on its mark: object t1 may still be there. Ready?"]
    again = Attended(light_bench, answer=True)
    run(tmp_path / "s", again, ["t1", "t2"], 2, resume=True)
    assert again.asked == alone.asked
    assert [row.object for row in read_lifts(tmp_path / "s")] == ["t1", "t1", "t2", "t2"]


def test_fallen_object_needs_a_person(
    tmp_path: Path, light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_lifts(monkeypatch, falling=["t1"])
    alone = Attended(light_bench)
    with pytest.raises(OperatorStopError, match="the last object fell or may lie anywhere: a person has to"):
        run(tmp_path / "s", alone, ["t1"], 2)
    (row,) = read_lifts(tmp_path / "s")
    assert row.outcome is LiftOutcome.FALLEN
    refused_again(tmp_path / "s", light_bench, ["t1"], 2)
    fed = Attended(light_bench, feeder="magazine 2")
    run(tmp_path / "s", fed, ["t1"], 2, resume=True)
    assert (fed.begun, fed.asked) == (["t1/2"], [])
    assert "t1 (wrench) was placed by the feeder 'magazine 2'" in (tmp_path / "s" / "log.txt").read_text()
    person = Attended(light_bench, answer=True)
    run(tmp_path / "p", person, ["t1"], 2)
    assert person.asked == [
        "Place object t1 (wrench) on its mark: the last object fell or may lie anywhere. Ready?"
    ]


def test_fault_needs_a_person(
    tmp_path: Path, light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_lifts(monkeypatch, fault="gripper: blocked")
    alone = Attended(light_bench)
    with pytest.raises(OperatorStopError, match="a person has to place"):
        run(tmp_path / "s", alone, ["t1"], 1)
    assert [row.outcome for row in read_lifts(tmp_path / "s")] == [LiftOutcome.FAULT]
    refused_again(tmp_path / "s", light_bench, ["t1"], 1)


@pytest.mark.parametrize("lost_with", ["unfinished", "its final name"])
def test_interrupted_lift_needs_a_person(
    tmp_path: Path, light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch, lost_with: str
) -> None:
    """A program that is killed leaves a recording: unfinished, or with its final name but without a row."""

    def stopped(*_: object) -> None:
        raise OperatorStopError("stopped by the operator")

    function = "rig.sessions.session.Session." + ("adopt" if lost_with == "unfinished" else "add")
    with monkeypatch.context() as patch:
        patch.setattr(function, stopped)
        with pytest.raises(OperatorStopError, match="by the operator"):
            run(tmp_path / "s", Attended(light_bench), ["t1"], 1)
    assert read_lifts(tmp_path / "s") == []
    alone = refused_again(tmp_path / "s", light_bench, ["t1"], 1)
    assert "the last attempt was interrupted, and its object may lie anywhere" in alone.asked[0]


def test_object_that_was_set_down_needs_nobody_after_a_resume(
    tmp_path: Path, light_bench: BenchConfig
) -> None:
    def stopped(*_: object) -> None:
        raise OperatorStopError("stopped by the operator")

    settings = TrialSettings(light_bench, 0, choose_estimator("pca"))
    with pytest.raises(OperatorStopError, match="by the operator"):
        run_trial(tmp_path / "s", settings, ["t1"], 2, benches=Attended(light_bench), progress=stopped)
    alone = Attended(light_bench)
    run(tmp_path / "s", alone, ["t1"], 2, resume=True)
    assert (alone.begun, alone.asked) == (["t1/2"], [])


@pytest.mark.heavy
def test_recording_needs_a_person_after_a_fault(tmp_path: Path, light_bench: BenchConfig) -> None:
    fault = {"device": "gripper", "kind": "blocked", "at_s": 4.0}
    bench = BenchConfig.model_validate({**light_bench.model_dump(), "faults": [fault]})
    alone = Attended(bench, object_id="7")
    settings = RecordSettings(bench, 0, find_grasp_file("7"), 2, 8)
    with pytest.raises(OperatorStopError, match="a person has to place object 7"):
        run_record(tmp_path / "s", settings, benches=alone)
    assert [row.accepted for row in read_poses(tmp_path / "s")] == [False]
    again = Attended(bench, object_id="7")
    with pytest.raises(OperatorStopError, match=r"the last object fell .*: a person has to place object 7"):
        run_record(tmp_path / "s", settings, True, again)
    assert again.begun == []
