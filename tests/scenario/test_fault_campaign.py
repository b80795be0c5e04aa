"""A part of `rig benchmark faults --full`, in real time: two faults at once at a moment of the grasp."""

from pathlib import Path

import pytest

from rig.benchmark.harness import Run
from rig.benchmark.wire.campaign import FILM, PART_FOLDER, run_campaign
from rig.benchmark.wire.fault_cases import CASES, both
from rig.benchmark.wire.faults import judge_faults
from rig.benchmark.wire.moments import Moment, Stage
from rig.config import BenchConfig

pytestmark = [pytest.mark.real_time, pytest.mark.long]


def test_two_faults_at_once_are_come_through_kept_and_filmed(
    tmp_path: Path, unhurried_bench: BenchConfig
) -> None:
    by_name = {case.name: case for case in CASES}
    two = both(by_name["arm: protective stop"], by_name["camera: unplugged"])
    run = Run(jobs=1, folder=tmp_path / "c")
    (row,) = run_campaign(run, [(two, Moment(Stage.GRASP, 1.0))], unhurried_bench)
    assert (row.fault, row.stage) == ("arm: protective stop + camera: unplugged", "grasp")
    assert row.passed, row
    assert all(limit.met for limit in judge_faults([row]))
    assert (tmp_path / "c" / FILM).stat().st_size > 10_000
    assert not list((tmp_path / "c").glob(f"{PART_FOLDER}*"))
