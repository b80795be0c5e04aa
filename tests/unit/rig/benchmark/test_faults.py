"""A fault that the rig does not recover from fails its case, and the next cases still run."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError
from rig.benchmark.harness import Run
from rig.benchmark.wire import faults
from rig.benchmark.wire.campaign import Stage
from rig.benchmark.wire.faults import CASES, FaultsOptions, FaultyLift, measure, run_to_the_end


def trial_that_fails(at: list[int], attempts: list[FaultyLift]) -> Callable[[bool], None]:
    """A trial of three lifts; each number in `at` is a lift at which it ends with an error, in turn."""
    results = [FaultyLift(case) for case in CASES[:3]]

    def run(resume: bool) -> None:
        assert resume == bool(attempts)
        if at:
            attempts.extend([results[at.pop(0)]] * 3)
            raise DeviceError("three rig faults in a row")

    return run


def test_trial_continues_after_a_failed_case() -> None:
    attempts: list[FaultyLift] = []
    run_to_the_end(trial_that_fails([0, 2], attempts), attempts)
    assert [result.case for result in attempts[::3]] == [CASES[0], CASES[2]]
    assert all(lift.given_up and not lift.passed for lift in attempts)


TWICE_BROKEN = next(case for case in CASES if case.mended_after == 2)


def test_benchmark_ends_if_no_lift_works_or_the_bench_stays_unreachable() -> None:
    attempts: list[FaultyLift] = []
    with pytest.raises(DeviceError, match="in a row"):
        run_to_the_end(trial_that_fails([1, 1, 1], attempts), attempts)
    assert len(attempts) == 6

    def run(resume: bool) -> None:
        if not resume:
            unreachable.extend([FaultyLift(TWICE_BROKEN)] * 3)
        raise DeviceError("remote control is off")

    unreachable: list[FaultyLift] = []
    with pytest.raises(DeviceError, match="remote control is off"):
        run_to_the_end(run, unreachable)
    assert len(unreachable) == 3


def test_repaired_case_gets_further_attempts() -> None:
    case, attempts, over = FaultyLift(TWICE_BROKEN), list[FaultyLift](), iter([False, True])

    def run(resume: bool) -> None:
        attempts.extend([case] * 3)
        if not next(over):
            raise DeviceError("three rig faults in a row")

    run_to_the_end(run, attempts)
    assert not case.given_up


def test_lift_stopped_before_its_fault_gets_it_in_the_next_attempt() -> None:
    result, over = FaultyLift(CASES[0]), threading.Event()
    result.note_stop(over, to_ns(1.0))
    assert over.is_set()
    assert not result.detected_ns


def test_first_stop_after_a_fault_is_its_detection_time() -> None:
    result, over = FaultyLift(CASES[0], injected_ns=to_ns(1.0)), threading.Event()
    for at_s in (1.2, 1.4):
        result.note_stop(over, to_ns(at_s))
    assert seconds(result)[0] == pytest.approx(0.2)
    assert not over.is_set()


def test_case_names_are_unique_and_cover_every_device() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {name.partition(":")[0] for name in names} == {"arm", "gripper", "fingertip", "camera"}


def seconds(lift: FaultyLift) -> list[float]:
    return [cell.value for cell in lift.row() if cell.name in ("seen_s", "safe_s")]


def lift(**changes: object) -> FaultyLift:
    found = FaultyLift(CASES[0], stage=Stage.LIFT, faults=["arm: protective stop"], recovered=True)
    found.injected_ns, found.detected_ns, found.still_ns = to_ns(1.0), to_ns(1.2), to_ns(1.3)
    for name, value in changes.items():
        setattr(found, name, value)
    return found


UNSEEN = {"faults": [], "detected_ns": 0}


@pytest.mark.parametrize(
    ("changes", "passed"),
    [
        ({}, True),
        ({"faults": ["DeviceError: gripper"]}, False),
        ({"still_ns": to_ns(2.5)}, False),
        ({"recovered": False}, False),
        ({"dropped": True}, False),
        (UNSEEN, False),
        (UNSEEN | {"stage": Stage.RELEASE}, True),
    ],
)
def test_fault_passes_only_if_detected_named_made_safe_and_recovered(
    changes: dict[str, object], passed: bool
) -> None:
    assert lift(**changes).passed is passed


def test_each_fault_has_a_row_with_times_and_outcome_and_counts_for_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = "DeviceError: arm: protective stop; look at it [stopped where it was (no way), nothing held]"
    lifts = [lift(faults=[outcome]), lift(**UNSEEN), lift(dropped=True, recovered=False)]
    monkeypatch.setattr(faults, "run_faults", lambda *_: lifts)
    report = measure(FaultsOptions(["arm"]), Run(folder=tmp_path))
    seen, unseen, fallen = report.tables[0].rows
    said = "DeviceError: arm: protective stop (stopped where it was)"
    assert seen == ("arm: protective stop", "0.200", "0.100", said, "done", "passed")
    assert unseen == ("arm: protective stop", "never", "never", "no fault was noticed", "done", "FAILED")
    assert fallen[-2:] == ("not done", "FAILED")
    records = report.tables[0].records
    assert [of["seen_s"] for of in records] == [pytest.approx(0.2), None, pytest.approx(0.2)]
    assert (records[0]["number"], records[0]["stage"], records[2]["dropped"]) == (1, Stage.LIFT, True)
    assert [limit.value for limit in report.limits] == [1, 1, 2]
    monkeypatch.setattr(faults, "run_faults", lambda *_: lifts[:1])
    assert all(limit.met for limit in measure(FaultsOptions(["arm"]), Run(folder=tmp_path)).limits)


def test_unknown_case_is_refused() -> None:
    with pytest.raises(InputError, match="no case contains elbow"):
        measure(FaultsOptions(["elbow"]), Run())
