"""Whole trials: counts that mean what they say, resuming, replaying, being killed."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.sessions.rows import read_finished_lifts, read_lifts
from rig.tactile.estimators import choose_estimator


def trial(folder: Path, lifts: int = 2, jobs: int = 1, resume: bool = False, **bench: object) -> object:
    values = load_bench("fake").model_dump()
    for tactile in values["tactile"]:
        tactile["rate_hz"] = 30.0  # half the frames, half the time; nothing here needs the other half
    config = BenchConfig.model_validate({**values, **bench})
    return run_trial(
        folder, TrialSettings(config, 0, choose_estimator()), ["t1"], lifts, jobs=jobs, resume=resume
    )


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


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trial") / "session"
    trial(folder)
    return folder


def test_side_by_side_gives_the_same_bytes_as_one_after_the_other(session: Path, tmp_path: Path) -> None:
    trial(tmp_path / "parallel", jobs=2)
    assert contents(tmp_path / "parallel") == contents(session)


def test_replay_is_exact_and_changes_nothing(session: Path) -> None:
    before = contents(session)
    replay = run_replay(session, None, None, jobs=1)
    assert replay.identical == 2
    assert contents(session) == before
    other = run_replay(session, "pca", 4, jobs=1)
    assert other.identical == 0
    assert other.summary.lifts_accepted == 2


def test_swapping_the_frames_of_two_lifts_swaps_their_estimates(session: Path, tmp_path: Path) -> None:
    import shutil

    swapped = tmp_path / "swapped"
    shutil.copytree(session, swapped)
    first, second = swapped / "lifts/001.mcap", swapped / "lifts/002.mcap"
    first.rename(tmp_path / "x")
    second.rename(first)
    (tmp_path / "x").rename(second)
    stored = read_finished_lifts(session)
    replayed = run_replay(swapped, None, None, jobs=1).rows
    assert replayed[0].final_estimate_deg == stored[1].final_estimate_deg
    assert replayed[1].final_estimate_deg == stored[0].final_estimate_deg


def test_a_faulty_lift_is_kept_and_repeated_until_accepted(tmp_path: Path) -> None:
    fault = {"device": "arm", "kind": "protective_stop", "at_s": 8.0, "lift": "t1/1"}
    summary = trial(tmp_path / "s", lifts=1, faults=[fault])
    rows = read_lifts(tmp_path / "s")
    assert [(row.attempt, row.accepted) for row in rows] == [(0, False), (1, True)]
    assert summary.lifts_accepted == 1  # type: ignore[attr-defined]
    assert (tmp_path / "s" / rows[0].recording).exists()
    assert (tmp_path / "s" / rows[1].recording).exists()


def test_three_faults_in_a_row_end_the_trial_and_keep_what_was_done(tmp_path: Path) -> None:
    fault = {"device": "camera", "kind": "disconnect", "at_s": 0.0, "lift": "t1/2", "attempt": None}
    with pytest.raises(DeviceError, match="3 rig faults in a row"):
        trial(tmp_path / "s", faults=[fault])
    rows = read_lifts(tmp_path / "s")
    assert [row.accepted for row in rows] == [True, False, False, False]


COMMAND = [sys.executable, "-m", "rig", "trial", "--object", "t2", "--lifts", "3"]


def _run_until(folder: Path, delay_s: float, how: signal.Signals, jobs: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [*COMMAND, "--jobs", jobs, "--out", str(folder), "--resume"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(delay_s)
    process.send_signal(how)
    process.communicate(timeout=60)
    return process


def test_killed_at_random_moments_it_loses_only_what_was_in_progress(tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    chance = random.Random(11)
    kept: list[int] = []
    for _ in range(5):
        _run_until(folder, chance.uniform(0.3, 5.0), signal.SIGKILL, jobs=chance.choice("12"))
        rows = read_lifts(folder)
        numbers = [row.number for row in rows]
        assert numbers[: len(kept)] == kept or sorted(numbers)[: len(kept)] == sorted(kept)
        assert all((folder / row.recording).stat().st_size > 0 for row in rows)
        kept = numbers
    done = subprocess.run(
        [*COMMAND, "--jobs", "1", "--out", str(folder), "--resume", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout)["lifts_accepted"] == 3
    rows = read_lifts(folder)
    assert [row.number for row in rows] == [1, 2, 3]
    again = subprocess.run(
        [*COMMAND, "--out", str(folder), "--resume", "--json"], capture_output=True, text=True, check=True
    )
    assert json.loads(again.stdout)["mare_deg"] == json.loads(done.stdout)["mare_deg"]


def test_ctrl_c_ends_safely_and_leaves_no_process(tmp_path: Path) -> None:
    process = _run_until(tmp_path / "stopped", 3.0, signal.SIGINT, jobs="2")
    assert process.returncode == 3
    assert _left_after_a_while(process.pid) == []


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    process = _run_until(tmp_path / "killed", 3.0, signal.SIGKILL, jobs="2")
    assert _left_after_a_while(process.pid) == []


def _left_after_a_while(session_id: int) -> list[int]:
    deadline = time.monotonic() + 10.0
    while _processes_of(session_id) and time.monotonic() < deadline:
        time.sleep(0.1)
    return _processes_of(session_id)


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
