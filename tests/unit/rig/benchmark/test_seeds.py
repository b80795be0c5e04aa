"""`rig benchmark seeds`, on one lift a seed."""

from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.benchmark.estimators.scores import score_series
from rig.benchmark.seeds.benchmark import SEEDS, SeedLift, judge_lifts, run_seeds, table
from rig.config import BenchConfig, load_bench


def lift(error_deg: float, sigma_deg: float, wrong: int = 0) -> SeedLift:
    truth = [10.0 * i for i in range(4)]
    told = [true + error_deg for true in truth]
    return SeedLift(0, score_series("7/1", told, [sigma_deg] * 4, truth), 30.0, wrong)


def test_seeds_go_on_where_they_ended_and_keep_no_recordings(
    light_bench: BenchConfig, tmp_path: Path
) -> None:
    one = run_seeds(tmp_path, light_bench, [3], 1, objects=["7"], lifts=1)
    both = run_seeds(tmp_path, light_bench, [3, 4], 1, resume=True, objects=["7"], lifts=1)
    assert [told.seed for told in both.lifts] == [3, 4]
    assert both.lifts[0] == one.lifts[0]
    assert [path.name for path in tmp_path.iterdir()] == [SEEDS]
    assert both.lifts[0].score.re is not None
    assert both.lifts[0].score.re.mean_deg < 2.0
    assert [row[0] for row in table(both).rows] == ["all", "3", "4"]
    with pytest.raises(InputError, match="holds 2 trials"):
        run_seeds(tmp_path, light_bench, [3], 1)


def test_seeds_are_for_benches_in_this_process(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in this process"):
        run_seeds(tmp_path, load_bench("wire"), [0], 1)
    assert not list(tmp_path.iterdir())


def test_a_lift_that_is_surely_wrong_misses_a_limit() -> None:
    assert all(limit.met for limit in judge_lifts("easy", [lift(0.1, 1.0)]))
    missed = [
        limit.name
        for limit in judge_lifts("easy", [lift(0.1, 1.0), lift(15.0, 1.0, wrong=4)])
        if not limit.met
    ]
    assert "lifts with an answer that is confidently wrong" in missed
    assert "worst lift, degrees" in missed
    assert all(limit.met for limit in judge_lifts("hard", [lift(0.5, 1.0)]))
