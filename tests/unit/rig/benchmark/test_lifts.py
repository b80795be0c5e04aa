"""`rig benchmark lifts`: lifts on a bench, one per seed, and a drawn one."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.benchmark import renderer
from rig.benchmark.harness import RESULTS, Run
from rig.benchmark.lifts import (
    DRAWN,
    LiftCase,
    LiftsOptions,
    ScoredLift,
    carry_out,
    judge_lifts,
    lifts_table,
    measure,
)
from rig.results.scores import score_series
from rig.tactile.estimators import choose_estimator
from support.benches import short_phases

BLADE = 20 + renderer.KIND_NAMES.index("blade")  # a lift whose object turns by 14 degrees


def lift(error_deg: float, sigma_deg: float, estimator: str = "slip", seed: int = 0) -> ScoredLift:
    truth = [10.0 * i for i in range(4)]
    angles = [true + error_deg for true in truth]
    score = score_series("7/1", angles, [sigma_deg] * 4, truth)
    return ScoredLift(LiftCase("fake", estimator, seed, "7", 1), score, 30.0)


@pytest.mark.heavy
def test_seeds_resume_and_keep_no_recordings(light_bench_file: Path, tmp_path: Path) -> None:
    one_lift = LiftsOptions(of=str(light_bench_file), objects=["t1"], lifts=1)
    done: list[str] = []
    run = Run(3, 1, tmp_path, progress=lambda *of: done.append(of[2]))
    with short_phases():
        report = measure(one_lift, run)
    assert done == ["fake, slip, seed 3, t1/1", "fake, slip, seed 4, t1/1"]
    assert [path.name for path in tmp_path.iterdir()] == [RESULTS]
    assert [row[0] for row in report.tables[0].rows] == ["all", "3", "4"]
    assert all(limit.met for limit in report.limits), report.limits
    assert measure(one_lift, replace(run, resume=True)) == report
    assert len(done) == 2
    with pytest.raises(InputError, match="holds 2 results"):
        measure(one_lift, run)


def test_bench_outside_this_process_and_objects_of_drawn_lifts_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in this process"):
        measure(LiftsOptions("wire"), Run(folder=tmp_path))
    with pytest.raises(InputError, match="faces instead of objects"):
        measure(LiftsOptions(DRAWN, objects=["7"]), Run(folder=tmp_path))
    assert not list(tmp_path.iterdir())


def missed(difficulty: str, *lifts: ScoredLift) -> list[str]:
    return [limit.name for limit in judge_lifts(difficulty, lifts) if not limit.met]


def test_confidently_wrong_lift_misses_limits() -> None:
    assert missed("easy", lift(0.1, 1.0)) == []
    few = missed("easy", lift(0.1, 1.0), lift(15.0, 1.0))
    assert "lifts with an answer that is confidently wrong" in few
    assert "worst lift, degrees" in few
    assert missed("hard", lift(0.5, 1.0)) == []


def test_too_large_sigma_misses_a_limit_of_a_whole_set() -> None:
    """Of fewer lifts, all answers may be within two sigma."""
    assert missed("easy", *[lift(0.1, 1.0)] * 45) == ["share of answers within two sigma"]


def test_table_names_estimators_only_if_there_are_several() -> None:
    two_seeds = [lift(0.1, 1.0), lift(0.2, 1.0, seed=1)]
    one = lifts_table("fake", {"slip": two_seeds})
    assert one.columns[0] == "seed"
    assert [row[0] for row in one.rows] == ["all", "0", "1"]
    assert "'slip'" in one.title
    both = lifts_table("fake", {"slip": two_seeds, "ecc": [lift(0.1, 1.0, "ecc")]})
    assert [row[:3] for row in both.rows] == [
        ("slip", "all", "2"),
        ("", "0", "1"),
        ("", "1", "1"),
        ("ecc", "all", "1"),
    ]


@pytest.mark.heavy
def test_drawn_lift_is_scored_as_in_a_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderer, "RATE_HZ", 20.0)
    choice = choose_estimator("slip")
    drawn = carry_out(None, {choice.name: choice}, LiftCase(DRAWN, choice.name, 0, "blade", BLADE))
    assert drawn.score.answered > 0.95
    assert drawn.score.re is not None
    assert drawn.score.re.mean_deg < 1.0
    assert drawn.score.wrong == 0
    assert abs(drawn.turned_deg) > 10.0
    assert lifts_table(DRAWN, {choice.name: [drawn]}).columns[0] == "face"
