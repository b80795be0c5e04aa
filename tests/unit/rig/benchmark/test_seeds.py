"""`rig benchmark seeds`, on one lift per seed."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.benchmark.harness import RESULTS, Run
from rig.benchmark.seeds import SeedLift, SeedsOptions, judge_lifts, measure
from rig.results.scores import score_series
from support.benches import short_phases


def lift(error_deg: float, sigma_deg: float) -> SeedLift:
    truth = [10.0 * i for i in range(4)]
    angles = [true + error_deg for true in truth]
    return SeedLift(0, score_series("7/1", angles, [sigma_deg] * 4, truth), 30.0)


@pytest.mark.heavy
def test_seeds_resume_and_keep_no_recordings(light_bench_file: Path, tmp_path: Path) -> None:
    one_lift = SeedsOptions(bench=str(light_bench_file), objects=["7"], lifts=1)
    done: list[str] = []
    run = Run(3, 1, tmp_path, progress=lambda *of: done.append(of[2]))
    with short_phases():
        report = measure(one_lift, run)
    assert done == ["fake, seed 3, 7/1", "fake, seed 4, 7/1"]
    assert [path.name for path in tmp_path.iterdir()] == [RESULTS]
    assert [row[0] for row in report.tables[0].rows] == ["all", "3", "4"]
    assert all(limit.met for limit in report.limits)
    assert measure(one_lift, replace(run, resume=True)) == report
    assert len(done) == 2
    with pytest.raises(InputError, match="holds 2 results"):
        measure(one_lift, run)


def test_seeds_reject_bench_outside_this_process(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in this process"):
        measure(SeedsOptions(bench="wire"), Run(folder=tmp_path))
    assert not list(tmp_path.iterdir())


def test_confidently_wrong_lift_misses_limits() -> None:
    assert all(limit.met for limit in judge_lifts("easy", [lift(0.1, 1.0)]))
    missed = [limit.name for limit in judge_lifts("easy", [lift(0.1, 1.0), lift(15.0, 1.0)]) if not limit.met]
    assert "lifts with an answer that is confidently wrong" in missed
    assert "worst lift, degrees" in missed
    assert all(limit.met for limit in judge_lifts("hard", [lift(0.5, 1.0)]))
