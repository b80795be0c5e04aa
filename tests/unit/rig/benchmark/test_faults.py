"""A fault that the rig does not recover from fails its case, and the next cases still run."""

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError
from drivers.types import Frame
from rig.benchmark.wire.campaign import (
    FILE,
    PART,
    FaultRow,
    _parts_left,
    _pictures,
    campaign_rows,
    campaign_section,
    count_faults,
    judge_campaign,
    plan_campaign,
    row_of,
    run_campaign,
    worst,
)
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.faults import FaultResult, _note_stop, _run_to_the_end
from rig.benchmark.wire.moments import Stage
from rig.sessions.codec import json_line
from rig.sessions.files import append_line


def trial_that_fails(at: list[int], attempts: list[FaultResult]) -> Callable[[bool], None]:
    """A trial of three lifts; each number in `at` is a lift at which it ends with an error, in turn."""
    results = [FaultResult(case) for case in CASES[:3]]

    def run(resume: bool) -> None:
        assert resume == bool(attempts)
        if at:
            attempts.extend([results[at.pop(0)]] * 3)
            raise DeviceError("three rig faults in a row")

    return run


def test_the_trial_goes_on_after_a_case_that_failed() -> None:
    attempts: list[FaultResult] = []
    _run_to_the_end(trial_that_fails([0, 2], attempts), attempts)
    assert [result.case for result in attempts[::3]] == [CASES[0], CASES[2]]
    assert all(result.given_up and not result.passed for result in attempts)


def test_a_bench_on_which_nothing_works_ends_the_benchmark() -> None:
    attempts: list[FaultResult] = []
    with pytest.raises(DeviceError, match="in a row"):
        _run_to_the_end(trial_that_fails([1, 1, 1], attempts), attempts)
    assert len(attempts) == 6


def test_a_bench_that_cannot_be_reached_again_ends_the_benchmark() -> None:
    attempts: list[FaultResult] = []

    def run(resume: bool) -> None:
        if not resume:
            attempts.extend([FaultResult(next(case for case in CASES if case.mended_after == 2))] * 3)
        raise DeviceError("remote control is off")

    with pytest.raises(DeviceError, match="remote control is off"):
        _run_to_the_end(run, attempts)
    assert len(attempts) == 3


def test_a_case_that_is_mended_after_two_attempts_is_not_given_up_after_one_more() -> None:
    case = FaultResult(next(case for case in CASES if case.mended_after == 2))
    attempts: list[FaultResult] = []
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
    result, over = FaultResult(CASES[0], reacts=reacts), threading.Event()
    _note_stop(result, over, to_ns(1.0))
    assert over.is_set() is not reacts
    assert not result.detected_ns


def test_the_first_stop_after_a_fault_is_when_it_was_seen() -> None:
    result, over = FaultResult(CASES[0], injected_ns=to_ns(1.0)), threading.Event()
    for at_s in (1.2, 1.4):
        _note_stop(result, over, to_ns(at_s))
    assert result.detected_s == pytest.approx(0.2)
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
    found = FaultResult(CASES[0], stage=Stage.LIFT, faults=["arm: protective stop"], recovered=True)
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
        limit.name for limit in judge_campaign([good, row(dropped=True, recovered=False)]) if not limit.met
    }
    assert len(missed) == 3
    assert all(limit.met for limit in judge_campaign([good]))


def test_faults_that_were_kept_are_not_run_again(tmp_path: Path) -> None:
    plan = plan_campaign(0, 1)
    kept = replace(row(), fault=plan[0][0].name)
    append_line(tmp_path / FILE, json_line(kept))
    with pytest.raises(InputError, match="--resume"):
        run_campaign(tmp_path, plan)
    assert run_campaign(tmp_path, plan, resume=True) == [kept]


def test_a_campaign_does_not_go_on_with_another_plan(tmp_path: Path) -> None:
    plan = plan_campaign(0, 1)
    append_line(tmp_path / FILE, json_line(replace(row(), fault="somebody trips over a cable")))
    with pytest.raises(InputError, match="another plan's"):
        run_campaign(tmp_path, plan, resume=True)


def test_a_campaign_goes_on_with_what_is_left_in_parts_that_share_no_bench() -> None:
    plan = plan_campaign(0, 4 * PART)[: 2 * PART + 5]
    assert [(part.first, len(part.planned)) for part in _parts_left(plan, {})] == [
        (1, PART),
        (PART + 1, PART),
        (2 * PART + 1, 5),
    ]
    done = {number: row() for number in (*range(1, PART + 1), PART + 3)}
    parts = _parts_left(plan, done)
    assert [part.first for part in parts] == [PART + 1, PART + 4, 2 * PART + 4]
    assert [planned for part in parts for planned in part.planned] == [
        planned for number, planned in enumerate(plan, start=1) if number not in done
    ]
    assert len({part.folder for part in parts}) == len(parts)


def test_the_worst_case_is_the_one_that_failed_or_stood_last() -> None:
    slow, failed = row(still_ns=to_ns(1.9)), row(recovered=False)
    assert worst([row(), slow]) == slow
    assert worst([slow, failed]) == failed
    assert worst([row(faults=[], detected_ns=0)]) is None


def test_a_film_shows_all_sources_side_by_side() -> None:
    def stream(width: int, height: int) -> list[Frame]:
        image = np.full((height, width, 3), 90, np.uint8)
        return [Frame(image, to_ns(i / 30), i, "serial") for i in range(30)]

    pictures = list(_pictures([stream(24, 32), stream(24, 32), stream(64, 48)], "SIMULATED"))
    assert 27 <= len(pictures) <= 30
    assert {picture.shape for picture in pictures} == {(360, 270 + 270 + 480, 3)}


def test_the_table_has_a_row_for_each_fault() -> None:
    table = campaign_rows([row(), row(faults=[], detected_ns=0, stage=Stage.RELEASE)])
    assert len(table) == len(CASES)
    assert table[0][1:] == ["2", "0", "0.20", "0.20", "0.30", "1", "0", "2 of 2", "2 of 2"]


def test_a_page_takes_the_table_with_its_limits() -> None:
    section = campaign_section("SIMULATED, 2 faults", [row(), row(recovered=False)])
    head, _, *lines = section.splitlines()
    assert head == "SIMULATED, 2 faults."
    assert sum(line.startswith("| ") for line in lines) == len(CASES) + 2
    assert "- lifts after a fault that did not run: 1 (at most 0)" in lines
