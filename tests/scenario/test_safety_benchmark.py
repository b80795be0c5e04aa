"""Two runs of `rig benchmark safety` with real programs: stopped on its way down, killed in mid-lift."""

from pathlib import Path

import pytest

from rig.benchmark.wire.moments import Moment, Stage
from rig.benchmark.wire.safety import run_safety
from rig.benchmark.wire.safety_events import BY_NAME, PlannedRun
from rig.benchmark.wire.safety_limits import judge_runs
from rig.config import BenchConfig

pytestmark = pytest.mark.real_time


def test_a_lift_stopped_and_one_killed_keep_every_limit(tmp_path: Path, unhurried_bench: BenchConfig) -> None:
    plan = [
        PlannedRun(1, BY_NAME["Ctrl-C"], Moment(Stage.APPROACH, 0.9)),
        PlannedRun(2, BY_NAME["kill -9"], Moment(Stage.LIFT, 0.5)),
    ]
    runs = run_safety(tmp_path / "s", plan, bench=unhurried_bench)
    assert [(run.event, run.stage) for run in runs] == [("Ctrl-C", "approach"), ("kill -9", "lift")]
    missed = [limit for limit in judge_runs(runs) if not limit.met]
    assert not missed, (missed, runs)
    assert runs[0].ended == 3
