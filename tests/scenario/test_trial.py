"""Whole trials: replayed, repeated after faults, stopped and killed."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings, stored_trial
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.sessions.rows import read_finished_lifts, read_lifts
from rig.tactile.estimators import choose_estimator
from support.benches import lighter, short_phases
from support.command_line import rig
from support.marks import heavy
from support.waiting import until

pytestmark = pytest.mark.heavy


def contents(folder: Path) -> dict[str, bytes]:
    """All that must be equal for equal seeds: everything but times and dates."""
    files = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    for name in ("timing.jsonl", ".lock"):
        files.pop(name, None)
    files["log.txt"] = b"".join(line.split(b" ", 2)[2] for line in files["log.txt"].splitlines())
    manifest = json.loads(files["session.json"])
    dates = {key: manifest.pop(key) for key in ("started", "completed")}
    assert all(dates.values())
    files["session.json"] = json.dumps(manifest).encode()
    return files


def test_parallel_trial_writes_the_same_bytes_as_a_sequential_one(tmp_path: Path) -> None:
    settings = TrialSettings(lighter(), 0, choose_estimator("pca"))
    for name, jobs in (("parallel", 2), ("sequential", 1)):
        run_trial(tmp_path / name, settings, ["t2"], lifts=2, jobs=jobs)
    assert contents(tmp_path / "parallel") == contents(tmp_path / "sequential")


def test_replay_is_exact_with_any_number_of_blas_threads_and_changes_nothing(one_lift: Path) -> None:
    before = contents(one_lift)
    with threadpool_limits(2):
        replay = run_replay(stored_trial(one_lift), jobs=1)
    assert replay.agreement == (1, 1, 0.0)
    assert contents(one_lift) == before


def test_trial_with_pictures_of_the_markers_only_is_smaller_and_replayed(
    one_lift: Path, light_bench: BenchConfig, tmp_path: Path
) -> None:
    settings = TrialSettings(light_bench, 0, choose_estimator("slip"), markers_only=True)
    with short_phases():
        run_trial(tmp_path / "s", settings, ["t2"], lifts=1)
    small, whole = ((folder / "lifts/001.mcap").stat().st_size for folder in (tmp_path / "s", one_lift))
    assert small < 0.75 * whole
    (stored,) = read_finished_lifts(one_lift)
    assert read_finished_lifts(tmp_path / "s") == [stored]
    (replayed,) = run_replay(stored_trial(tmp_path / "s"), jobs=1).rows
    assert replayed.final_estimate_deg == stored.final_estimate_deg
    assert replayed.final_truth_deg == pytest.approx(stored.final_truth_deg, abs=0.02)


@pytest.fixture
def command(light_bench_file: Path, tmp_path: Path) -> list[str]:
    """Arguments of `rig`: three lifts into one session, which is continued after an interruption."""
    what = ["--object", "t2", "--lifts", "3", "--bench", str(light_bench_file), "--no-report"]
    return ["trial", *what, "--out", str(tmp_path / "session"), "--resume"]


def _started(command: list[str], jobs: str) -> "subprocess.Popen[str]":
    """Start it as a process that leads a session of processes."""
    pipe, words = subprocess.PIPE, [sys.executable, "-m", "rig", *command, "--jobs", jobs]
    return subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def _end(process: "subprocess.Popen[str]", how: signal.Signals) -> None:
    process.send_signal(how)
    process.communicate(timeout=120)


def test_trial_killed_at_random_moments_loses_only_lifts_in_progress(
    command: list[str], tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    chance = random.Random(11)
    kept: list[int] = []
    for _ in range(5):
        process = _started(command, jobs=chance.choice("12"))
        time.sleep(chance.uniform(0.3, 4.0))
        _end(process, signal.SIGKILL)
        rows = read_lifts(folder)
        numbers = [row.number for row in rows]
        assert numbers[: len(kept)] == kept or sorted(numbers)[: len(kept)] == sorted(kept)
        assert all((folder / row.recording).stat().st_size > 0 for row in rows)
        kept = numbers
    done = rig(*command, "--jobs", "1", "--json")
    assert json.loads(done.stdout)["lifts_accepted"] == 3
    rows = read_lifts(folder)
    assert [row.number for row in rows] == [1, 2, 3]
    again = rig(*command, "--json")
    assert json.loads(again.stdout)["mare_deg"] == json.loads(done.stdout)["mare_deg"]


@pytest.fixture
def in_progress(command: list[str]) -> "subprocess.Popen[str]":
    """A trial whose two workers are at their lifts."""
    process = _started(command, jobs="2")
    until(lambda: len(_processes_of(process.pid)) >= 3)
    time.sleep(1.0)
    return process


@pytest.mark.parametrize(("how", "code"), [(signal.SIGKILL, -signal.SIGKILL), *heavy((signal.SIGINT, 3))])
def test_interrupted_or_killed_trial_leaves_no_process(
    in_progress: "subprocess.Popen[str]", how: signal.Signals, code: int
) -> None:
    _end(in_progress, how)
    assert in_progress.returncode == code
    until(lambda: not _processes_of(in_progress.pid), 120.0)


def _processes_of(session_id: int) -> list[int]:
    """Processes that still belong to a session, by the system's process table."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[3]) == session_id and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found
