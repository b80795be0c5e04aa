"""An interrupted lift leaves its recording, which is read up to its end and not counted."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from protocols.observer import Phase
from rig.config import BenchConfig
from rig.experiments.interrupted import interrupted_lifts
from rig.experiments.lift_plan import TrialSettings
from rig.results.listing import SessionState, list_session
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC
from rig.sessions.recording_file import recording_gaps
from rig.sessions.rows import read_finished_lifts
from rig.sessions.unfinished import unfinished_recordings
from rig.tactile.estimators import choose_estimator
from support.command_line import rig
from support.waiting import until

SETTINGS = ["--object", "t2", "--estimator", "pca", "--no-report", "--lifts"]
BYTES = 400_000
STARTED_S = 240.0
"""Longer than a program takes to begin a lift on a loaded host."""


def interrupted_after(size: int, how: signal.Signals, folder: Path, bench: Path, jobs: str = "1") -> None:
    """Start a trial of a lift per worker, and send it a signal when a recording of it has a size."""
    words = ["trial", *SETTINGS, jobs, "--jobs", jobs, "--bench", bench, "--out", folder, "--resume"]
    before = {path.stat().st_ino for path in unfinished_recordings(folder)}  # they are renamed

    def long_enough() -> bool:
        assert process.poll() is None
        new = (path.stat() for path in unfinished_recordings(folder))
        return any(of.st_size > size for of in new if of.st_ino not in before)

    with subprocess.Popen([sys.executable, "-m", "rig", *words], stderr=subprocess.DEVNULL) as process:
        try:
            until(long_enough, STARTED_S)
        finally:
            process.send_signal(how)


@pytest.fixture(scope="module")
def killed_once(tmp_path_factory: pytest.TempPathFactory, light_bench_file: Path) -> Path:
    """A session whose first lift was killed in the middle, to be read only."""
    folder = tmp_path_factory.mktemp("killed") / "s"
    interrupted_after(BYTES, signal.SIGKILL, folder, light_bench_file)
    return folder


@pytest.fixture
def killed(killed_once: Path, tmp_path: Path) -> Path:
    """A copy of it, to be written to."""
    return Path(shutil.copytree(killed_once, tmp_path / "s"))


def test_recording_of_a_killed_lift_is_kept_and_readable(killed: Path, light_bench: BenchConfig) -> None:
    [path] = unfinished_recordings(killed)
    assert path.name == "001.unfinished.mcap"
    assert recording_gaps(path) == []
    assert next(iter(phase_times(path))) == Phase.REFERENCE
    assert len(list(recorded_frames(path, "SIM-D0001"))) > 5
    settings = TrialSettings(light_bench, 0, choose_estimator("pca"))
    [lift], problems = interrupted_lifts(killed, settings)
    assert problems == ()
    assert lift.name == "toothbrush, lift 1"
    assert lift.seconds > 0.3
    assert not (killed / "lifts.jsonl").exists()
    entry = list_session(killed)
    assert (entry.state, entry.done, entry.problem) == (SessionState.UNFINISHED, 0, None)


def test_resumed_session_repeats_the_lift_and_keeps_the_interrupted_recording(
    killed: Path, two_lifts: Path, light_bench_file: Path
) -> None:
    first = (killed / "lifts" / "001.unfinished.mcap").read_bytes()
    interrupted_after(BYTES, signal.SIGINT, killed, light_bench_file)
    names = [path.name for path in unfinished_recordings(killed)]
    assert names == ["001.interrupted-1.mcap", "001.unfinished.mcap"]
    done = rig("trial", *SETTINGS, 1, "--bench", light_bench_file, "--out", killed, "--resume")
    assert done.returncode == 0, done.stderr
    (row,) = read_finished_lifts(killed)
    assert row.recording == "lifts/001.mcap"
    assert (killed / "lifts" / "001.interrupted-1.mcap").read_bytes() == first
    names = [path.name for path in unfinished_recordings(killed)]
    assert names == ["001.interrupted-1.mcap", "001.interrupted-2.mcap"]
    assert (killed / row.recording).read_bytes() == (two_lifts / row.recording).read_bytes()


@pytest.mark.long
def test_killed_parent_of_two_workers_leaves_both_recordings(tmp_path: Path, light_bench_file: Path) -> None:
    interrupted_after(BYTES, signal.SIGKILL, tmp_path / "s", light_bench_file, jobs="2")
    time.sleep(1.0)
    names = {path.name for path in unfinished_recordings(tmp_path / "s")}
    assert names <= {"001.unfinished.mcap", "002.unfinished.mcap"}
    assert names


def test_replay_and_play_show_an_interrupted_lift_that_reached_phase_b(
    killed: Path, tmp_path: Path, one_lift: Path, light_bench: BenchConfig
) -> None:
    """The recording of a whole lift, cut off in phase C as a kill would."""
    whole = (one_lift / "lifts" / "001.mcap").read_bytes()
    unfinished = killed / "lifts" / "001.unfinished.mcap"
    unfinished.write_bytes(whole[: len(whole) * 8 // 10])
    done = rig("replay", killed, "--json")
    assert done.returncode == 2  # no lift is finished
    [lift] = json.loads(done.stdout)["unfinished"]
    assert lift["recording"] == "lifts/001.unfinished.mcap"
    assert lift["phases"][:3] == ["reference", "A", "B"]
    assert lift["estimate_deg"] is not None
    assert "unfinished, not counted: lifts/001.unfinished.mcap: toothbrush, lift 1" in done.stderr
    film = tmp_path / "film.avi"
    played = rig("play", killed, "--lift", "001.unfinished", "--fps", "5", "--out", film)
    assert played.returncode == 0, played.stderr
    assert film.stat().st_size > 1000
    settings = TrialSettings(light_bench, 0, choose_estimator("pca"))
    [lift], _ = interrupted_lifts(killed, settings)
    assert lift.last_deg(FUSED_TOPIC) is not None
    assert lift.last_deg(TRUTH_TOPIC) is not None
