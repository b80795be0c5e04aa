"""Runs of `rig benchmark safety` with a real program: killed in mid-lift, and with blocked fingers.

Programs stopped on their way down: `test_bench_safety.py`.
"""

from pathlib import Path

import pytest

from rig.benchmark.harness import Run
from rig.benchmark.wire.moments import Moment, Stage
from rig.benchmark.wire.safety import judge_runs
from rig.benchmark.wire.safety_events import BY_NAME, PlannedRun
from rig.benchmark.wire.safety_runs import run_safety
from rig.config import BenchConfig

pytestmark = [pytest.mark.real_time, pytest.mark.long]


def test_killed_lift_and_blocked_fingers_keep_every_limit(
    tmp_path: Path, unhurried_bench: BenchConfig
) -> None:
    plan = [
        PlannedRun(1, BY_NAME["kill -9"], Moment(Stage.LIFT, 0.5)),
        PlannedRun(2, BY_NAME["fingers blocked"], Moment(Stage.HOLD, 0.2)),
    ]
    runs = run_safety(Run(folder=tmp_path / "s"), plan, unhurried_bench)
    assert [(run.event, run.stage) for run in runs] == [("kill -9", "lift"), ("fingers blocked", "hold")]
    missed = [limit for limit in judge_runs(runs) if not limit.met]
    assert not missed, (missed, runs)
    assert "nobody at the bench agreed" in runs[1].said
