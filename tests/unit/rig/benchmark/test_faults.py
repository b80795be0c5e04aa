"""A fault that the rig does not recover from fails its case, and the next cases still run."""

from collections.abc import Callable

import pytest

from drivers.errors import DeviceError
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.faults import FaultResult, _run_to_the_end


def trial_that_fails(at: list[int], attempts: list[FaultResult]) -> Callable[[bool], None]:
    """A trial of three lifts; each number in `at` is a lift at which it ends with an error, in turn."""
    results = [FaultResult(case) for case in CASES[:3]]

    def run(resume: bool) -> None:
        assert resume == bool(attempts)
        if at:
            attempts.append(results[at.pop(0)])
            raise DeviceError("three rig faults in a row")

    return run


def test_the_trial_goes_on_after_a_case_that_failed() -> None:
    attempts: list[FaultResult] = []
    _run_to_the_end(trial_that_fails([0, 2], attempts), attempts)
    assert [result.case for result in attempts] == [CASES[0], CASES[2]]
    assert all(result.given_up and not result.passed for result in attempts)


def test_a_bench_on_which_nothing_works_ends_the_benchmark() -> None:
    attempts: list[FaultResult] = []
    with pytest.raises(DeviceError, match="in a row"):
        _run_to_the_end(trial_that_fails([1, 1, 1], attempts), attempts)
    assert len(attempts) == 2


def test_the_cases_are_named_once_and_cover_every_device() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert {name.partition(":")[0] for name in names} == {"arm", "gripper", "fingertip", "camera"}
