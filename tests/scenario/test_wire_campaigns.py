"""Parts of `rig benchmark safety`, in slow motion.

Programs stopped on their way down: `test_bench_safety.py`.
"""

import subprocess
from pathlib import Path

import pytest

from drivers.children import python_command
from rig.benchmark.harness import Run
from rig.benchmark.wire.campaign import PlannedRun, Stage, start_trial
from rig.benchmark.wire.safety import BY_NAME, judge_runs, run_safety
from rig.config import BenchConfig
from support.slow_motion import IN_SLOW_MOTION, slow_down
from support.waiting import LIMIT_S

pytestmark = pytest.mark.heavy


def start_slow_trial(bench: Path, session: Path, object_id: str) -> "subprocess.Popen[str]":
    """Start a trial as the benchmark does, in slow motion."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.benchmark.wire.campaign.python_command", slow_command)
        return start_trial(bench, session, object_id)


def slow_command(flag: str, module: str, *arguments: object) -> list[str]:
    assert (flag, module) == ("-m", "rig")
    short = "import protocols.slip_trial as lift; lift.GRASP_S = lift.HOLD_S = 0.5"  # nothing happens there
    return python_command("-c", f"{IN_SLOW_MOTION}{short}; from rig.cli.main import main; main()", *arguments)


def test_killed_lift_lost_power_and_blocked_fingers_keep_every_limit(
    tmp_path: Path, unhurried_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow_down(monkeypatch, "rig.benchmark.wire.campaign")
    monkeypatch.setattr("rig.benchmark.wire.campaign.start_trial", start_slow_trial)
    monkeypatch.setattr("rig.benchmark.wire.safety.END_S", LIMIT_S)
    plan = [
        PlannedRun(1, BY_NAME["kill -9"], Stage.LIFT, 0.5),
        PlannedRun(2, BY_NAME["gripper without power"], Stage.LIFT, 0.4),
        PlannedRun(3, BY_NAME["fingers blocked"], Stage.HOLD, 0.2),
    ]
    runs = run_safety(Run(folder=tmp_path / "s"), plan, unhurried_bench)
    assert [run.stage for run in runs] == [Stage.LIFT, Stage.LIFT, Stage.HOLD]
    missed = [limit for limit in judge_runs(runs) if limit.met is False]
    assert not missed, (missed, runs)
    assert "the person at the bench did not agree" in runs[2].said
