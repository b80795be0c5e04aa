"""A fault that the rig does not recover from fails its case, and the next cases still run."""

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError
from rig.benchmark.harness import Run
from rig.benchmark.wire import faults
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.fault_lifts import (
    FaultRow,
    FaultyLift,
    Planned,
    _note_stop,
    _run_to_the_end,
    row_of,
)
from rig.benchmark.wire.faults import (
    PART,
    WORST,
    FaultsOptions,
    campaign_table,
    count_faults,
    judge_faults,
    measure,
    plan_campaign,
    run_campaign,
    worst,
)
from rig.benchmark.wire.world import Stage
from rig.config import load_bench
from rig.sessions.files import recording_file


def trial_that_fails(at: list[int], attempts: list[FaultyLift]) -> Callable[[bool], None]:
    """A trial of three lifts; each number in `at` is a lift at which it ends with an error, in turn."""
    results = [FaultyLift(case) for case in CASES[:3]]

    def run(resume: bool) -> None:
        assert resume == bool(attempts)
        if at:
            attempts.extend([results[at.pop(0)]] * 3)
            raise DeviceError("three rig faults in a row")

    return run


def test_the_trial_goes_on_after_a_case_that_failed() -> None:
    attempts: list[FaultyLift] = []
    _run_to_the_end(trial_that_fails([0, 2], attempts), attempts)
    assert [result.case for result in attempts[::3]] == [CASES[0], CASES[2]]
    assert all(lift.given_up and not lift.passed for lift in attempts)


def test_a_bench_on_which_nothing_works_ends_the_benchmark() -> None:
    attempts: list[FaultyLift] = []
    with pytest.raises(DeviceError, match="in a row"):
        _run_to_the_end(trial_that_fails([1, 1, 1], attempts), attempts)
    assert len(attempts) == 6


def test_a_bench_that_cannot_be_reached_again_ends_the_benchmark() -> None:
    attempts: list[FaultyLift] = []

    def run(resume: bool) -> None:
        if not resume:
            attempts.extend([FaultyLift(next(case for case in CASES if case.mended_after == 2))] * 3)
        raise DeviceError("remote control is off")

    with pytest.raises(DeviceError, match="remote control is off"):
        _run_to_the_end(run, attempts)
    assert len(attempts) == 3


def test_a_case_that_is_mended_after_two_attempts_is_not_given_up_after_one_more() -> None:
    case = FaultyLift(next(case for case in CASES if case.mended_after == 2))
    attempts: list[FaultyLift] = []
    over = iter([False, True])

    def run(resume: bool) -> None:
        attempts.extend([case] * 3)
        if not next(over):
            raise DeviceError("three rig faults in a row")

    _run_to_the_end(run, attempts)
    assert not case.given_up


@pytest.mark.parametrize("reacts", [False, True])
def test_a_lift_that_is_stopped_before_its_fault_meets_it_in_the_next_attempt(reacts: bool) -> None:
    """A lift that reacts stops the arm and goes on."""
    result, over = FaultyLift(CASES[0], reacts=reacts), threading.Event()
    _note_stop(result, over, to_ns(1.0))
    assert over.is_set() is not reacts
    assert not result.detected_ns


def test_the_first_stop_after_a_fault_is_when_it_was_seen() -> None:
    result, over = FaultyLift(CASES[0], injected_ns=to_ns(1.0)), threading.Event()
    for at_s in (1.2, 1.4):
        _note_stop(result, over, to_ns(at_s))
    assert row_of(1, result).seen_s == pytest.approx(0.2)
    assert not over.is_set()


def test_the_cases_are_named_once_and_cover_every_device() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {name.partition(":")[0] for name in names} == {"arm", "gripper", "fingertip", "camera"}


def test_a_campaign_has_each_fault_in_each_stage_and_many_with_another() -> None:
    plan = plan_campaign(0, 1000)
    assert count_faults(plan) in (1000, 1001)
    firsts = Counter((case.name.split(" + ")[0], moment.stage) for case, moment in plan)
    assert set(firsts) == {(case.name, stage) for case in CASES for stage in Stage}
    assert max(firsts.values()) - min(firsts.values()) <= 1
    two = [case for case, _ in plan if " + " in case.name]
    assert 0.25 < len(two) / len(plan) < 0.42
    assert len(plan) + len(two) == count_faults(plan)
    for case in two:
        one, other = (name.partition(":")[0] for name in case.name.split(" + "))
        assert one != other
        assert len(case.injected) >= 2
    assert plan_campaign(0, 30) == plan[: len(plan_campaign(0, 30))]


def row(**changes: object) -> FaultRow:
    found = FaultyLift(CASES[0], stage=Stage.LIFT, faults=["arm: protective stop"], recovered=True)
    found.injected_ns, found.detected_ns, found.still_ns = to_ns(1.0), to_ns(1.2), to_ns(1.3)
    for name, value in changes.items():
        setattr(found, name, value)
    return row_of(1, found)


def test_a_fault_passes_only_when_it_is_seen_named_safe_and_recovered_from() -> None:
    good = row()
    assert (good.seen_s, good.still_s, good.passed) == (pytest.approx(0.2), pytest.approx(0.3), True)
    assert not row(faults=["DeviceError: gripper"]).passed
    assert not row(still_ns=to_ns(2.5)).passed
    assert not row(recovered=False).passed
    assert not row(dropped=True).passed
    unseen = {"faults": [], "detected_ns": 0}
    assert not row(**unseen).passed
    assert row(**unseen, stage=Stage.RELEASE).passed
    missed = {
        limit.name for limit in judge_faults([good, row(dropped=True, recovered=False)]) if not limit.met
    }
    assert len(missed) == 3
    assert all(limit.met for limit in judge_faults([good]))


class Parts:
    """Stands for the lifts of a campaign: keeps what is run. Each recording holds the name of its fault."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.run: list[str] = []
        monkeypatch.setattr(faults, "run_faults", self._run)

    def _run(self, folder: Path, cases: list[Planned], bench: object) -> list[FaultRow]:
        self.run.append(folder.name)
        for i, (case, _) in enumerate(cases):
            path = folder / recording_file(i + 1, 0)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(case.name)
        still_s = {"part_1": 0.5, "part_11": 0.3, "part_21": 0.7}[folder.name]
        return [
            replace(row(), number=i + 1, fault=case.name, still_s=still_s)
            for i, (case, _) in enumerate(cases)
        ]


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    return Parts(monkeypatch)


PLAN, WIRE = plan_campaign(0, 100)[: 2 * PART + 5], load_bench("wire")


def test_campaign_runs_parts_of_ten_and_keeps_the_recording_of_the_worst(
    tmp_path: Path, parts: Parts
) -> None:
    notes: list[str] = []
    rows = run_campaign(Run(0, 1, tmp_path, progress=lambda *of: notes.append(of[2])), PLAN, WIRE)
    assert [(row.number, row.fault) for row in rows] == [
        (i, c.name) for i, (c, _) in enumerate(PLAN, start=1)
    ]
    assert parts.run == ["part_1", "part_11", "part_21"]
    assert (tmp_path / WORST).read_text() == PLAN[20][0].name
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.jsonl", WORST]
    assert notes[1].splitlines()[0] == "lifts 11 to 20:"
    assert f"11 {PLAN[10][0].name}, lift: seen after 0.20 s, stood after 0.30 s; passed" in notes[1]


def test_interrupted_campaign_continues_with_its_missing_parts(tmp_path: Path, parts: Parts) -> None:
    run = Run(0, 1, tmp_path)
    first = run_campaign(run, PLAN[:PART], WIRE)
    with pytest.raises(InputError, match="--resume"):
        run_campaign(run, PLAN, WIRE)
    rows = run_campaign(replace(run, resume=True), PLAN, WIRE)
    assert rows[:PART] == first
    assert parts.run == ["part_1", "part_11", "part_21"]
    assert (tmp_path / WORST).read_text() == PLAN[20][0].name


@pytest.mark.parametrize(("seed", "bench"), [(1, "wire"), (0, "other")])
def test_campaign_of_another_seed_or_bench_is_not_continued(
    seed: int, bench: str, tmp_path: Path, parts: Parts
) -> None:
    run_campaign(Run(0, 1, tmp_path), PLAN[:PART], WIRE)
    with pytest.raises(InputError, match="continue with the options that it was begun with"):
        run_campaign(Run(seed, 1, tmp_path, resume=True), PLAN, WIRE.model_copy(update={"name": bench}))


def test_campaign_with_other_faults_or_of_an_older_version_is_not_continued(
    tmp_path: Path, parts: Parts
) -> None:
    run = Run(0, 1, tmp_path, resume=True)
    run_campaign(run, PLAN[:PART], WIRE)
    with pytest.raises(InputError, match="of another version; give another folder"):
        run_campaign(run, PLAN[1:], WIRE)
    (tmp_path / "faults.jsonl").touch()
    with pytest.raises(InputError, match=r"faults\.jsonl.*older version; give another folder"):
        run_campaign(run, PLAN, WIRE)


def test_the_worst_case_is_the_one_that_failed_or_stood_last() -> None:
    slow, failed = row(still_ns=to_ns(1.9)), row(recovered=False)
    assert worst([row(), slow]) == slow
    assert worst([slow, failed]) == failed
    assert worst([row(faults=[], detected_ns=0)]) is None


def test_the_table_has_a_row_for_each_fault() -> None:
    table = campaign_table("wire", [row(), row(faults=[], detected_ns=0, stage=Stage.RELEASE)]).rows
    assert len(table) == len(CASES)
    assert table[0][1:] == ("2", "0", "0.20", "0.20", "0.30", "1", "0", "2 of 2", "2 of 2")


def test_a_page_takes_the_table_with_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "run_campaign", lambda run, plan, bench: [row(), row(recovered=False)])
    report = measure(FaultsOptions(full=True, count=2), Run())
    head, _, *lines = report.section.splitlines()
    assert head == "SIMULATED, 3 faults in 2 lifts at random moments, seed 0."
    assert sum(line.startswith("| ") for line in lines) == len(CASES) + 2
    assert "- lifts after a fault that did not run: 1 (at most 0)" in lines
    assert report.notes[0].startswith("longest until standstill: 1 arm: protective stop")


def test_each_fault_once_has_a_row_with_times_and_outcome(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = "DeviceError: arm: protective stop; look at it [stopped where it was (no way), nothing held]"
    unseen = row(faults=[], detected_ns=0)
    monkeypatch.setattr(faults, "run_faults", lambda *_: [row(faults=[outcome]), unseen])
    report = measure(FaultsOptions(["arm"]), Run(folder=tmp_path))
    assert report.tables[0].rows == [
        (
            "arm: protective stop",
            "0.200",
            "0.100",
            "DeviceError: arm: protective stop (stopped where it was)",
            "done",
            "passed",
        ),
        ("arm: protective stop", "never", "never", "no fault was noticed", "done", "FAILED"),
    ]
    assert [limit.value for limit in report.limits] == [0, 0, 1]


def test_each_fault_once_has_no_resumption_and_no_unknown_case() -> None:
    with pytest.raises(InputError, match="no case contains elbow"):
        measure(FaultsOptions(["elbow"]), Run())
    with pytest.raises(InputError, match="give --full"):
        measure(FaultsOptions(), Run(resume=True))
