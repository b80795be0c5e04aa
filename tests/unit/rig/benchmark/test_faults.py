"""A fault that the rig does not recover from fails its case, and the next cases still run."""

import threading
from pathlib import Path

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError
from rig.benchmark.harness import Run
from rig.benchmark.wire import faults
from rig.benchmark.wire.campaign import Stage
from rig.benchmark.wire.faults import CASES, FaultsOptions, FaultyLift, measure, run_to_the_end

TWICE_BROKEN = next(case for case in CASES if case.mended_after == 2)


def attempts_until_the_end(*failing: FaultyLift | None) -> list[FaultyLift]:
    """Run a trial; each run makes three attempts at a lift and ends with an error, without one if None."""
    attempts, runs = list[FaultyLift](), iter(failing)

    def run(resume: bool) -> None:
        assert resume == bool(attempts)
        if lift := next(runs, None):
            attempts.extend([lift] * 3)
            raise DeviceError("three rig faults in a row")

    run_to_the_end(run, attempts)
    return attempts


def test_trial_continues_after_a_failed_case() -> None:
    attempts = attempts_until_the_end(FaultyLift(CASES[0]), FaultyLift(CASES[2]))
    assert [result.case for result in attempts[::3]] == [CASES[0], CASES[2]]
    assert all(lift.given_up and not lift.passed for lift in attempts)
    assert not attempts_until_the_end(FaultyLift(TWICE_BROKEN))[0].given_up  # gets further attempts


def test_benchmark_ends_if_no_lift_works_or_the_bench_stays_unreachable() -> None:
    lift = FaultyLift(CASES[1])
    with pytest.raises(DeviceError, match="in a row"):
        attempts_until_the_end(lift, lift, lift)
    unreachable = [FaultyLift(TWICE_BROKEN)] * 3

    def run(resume: bool) -> None:
        raise DeviceError("remote control is off")

    with pytest.raises(DeviceError, match="remote control is off"):
        run_to_the_end(run, unreachable)
    assert len(unreachable) == 3


def lift(**changes: object) -> FaultyLift:
    found = FaultyLift(CASES[0], stage=Stage.LIFT, faults=["arm: protective stop"], recovered=True)
    found.injected_ns, found.detected_ns, found.still_ns = to_ns(1.0), to_ns(1.2), to_ns(1.3)
    for name, value in changes.items():
        setattr(found, name, value)
    return found


def test_first_stop_after_a_fault_is_its_detection_time() -> None:
    early, result, over = FaultyLift(CASES[0]), lift(detected_ns=0), threading.Event()
    for at_s in (1.2, 1.4):
        result.note_stop(over, to_ns(at_s))
    assert result.detected_ns == to_ns(1.2)
    assert not over.is_set()
    early.note_stop(over, to_ns(1.0))  # stopped before its fault, which it gets in the next attempt
    assert over.is_set()
    assert not early.detected_ns


def test_case_names_are_unique_and_cover_every_device() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {name.partition(":")[0] for name in names} == {"arm", "gripper", "fingertip", "camera"}
    with pytest.raises(InputError, match="no case contains elbow"):
        measure(FaultsOptions(["elbow"]), Run())


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
