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
from rig.benchmark.wire.faults import (
    CASES,
    FaultRow,
    FaultsOptions,
    FaultyLift,
    judge_faults,
    measure,
    run_to_the_end,
)


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


def test_benchmark_ends_if_no_lift_works() -> None:
    attempts: list[FaultyLift] = []
    with pytest.raises(DeviceError, match="in a row"):
        run_to_the_end(trial_that_fails([1, 1, 1], attempts), attempts)
    assert len(attempts) == 6


def test_benchmark_ends_if_the_bench_stays_unreachable() -> None:
    attempts: list[FaultyLift] = []

    def run(resume: bool) -> None:
        if not resume:
            attempts.extend([FaultyLift(next(case for case in CASES if case.mended_after == 2))] * 3)
        raise DeviceError("remote control is off")

    with pytest.raises(DeviceError, match="remote control is off"):
        run_to_the_end(run, attempts)
    assert len(attempts) == 3


def test_repaired_case_gets_further_attempts() -> None:
    case = FaultyLift(next(case for case in CASES if case.mended_after == 2))
    attempts: list[FaultyLift] = []
    over = iter([False, True])

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
    assert result.row(1).seen_s == pytest.approx(0.2)
    assert not over.is_set()


def test_case_names_are_unique_and_cover_every_device() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {name.partition(":")[0] for name in names} == {"arm", "gripper", "fingertip", "camera"}


def row(**changes: object) -> FaultRow:
    found = FaultyLift(CASES[0], stage=Stage.LIFT, faults=["arm: protective stop"], recovered=True)
    found.injected_ns, found.detected_ns, found.still_ns = to_ns(1.0), to_ns(1.2), to_ns(1.3)
    for name, value in changes.items():
        setattr(found, name, value)
    return found.row(1)


def test_fault_passes_only_if_detected_named_made_safe_and_recovered() -> None:
    good = row()
    assert (good.seen_s, good.safe_s, good.passed) == (pytest.approx(0.2), pytest.approx(0.1), True)
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


def test_unknown_case_is_refused() -> None:
    with pytest.raises(InputError, match="no case contains elbow"):
        measure(FaultsOptions(["elbow"]), Run())
