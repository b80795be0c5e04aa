"""An interrupted lift leaves its recording, which is read up to its end and not counted."""

import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from protocols.observer import Phase
from rig.results.listing import SessionState, list_session
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.recording_file import recording_gaps
from rig.sessions.rows import read_finished_lifts
from support.benches import short_phases
from support.command_line import answer, refusal, rig
from support.recordings import unfinished_recordings
from support.waiting import until

pytestmark = pytest.mark.heavy

SETTINGS = ["--object", "t2", "--estimator", "pca", "--no-report", "--lifts"]
BYTES = 400_000
STARTED_S = 240.0
"""Longer than a program takes to begin a lift on a loaded host."""


def interrupted_after(size: int, how: signal.Signals, folder: Path, bench: Path) -> None:
    """Start a trial of one lift, and send it a signal when a recording of it has a size."""
    words = ["trial", *SETTINGS, "1", "--jobs", "1", "--bench", bench, "--out", folder, "--resume"]
    before = {path.stat().st_ino for path in unfinished_recordings(folder)}  # they are renamed

    def long_enough() -> bool:
        assert process.poll() is None
        with suppress(FileNotFoundError):  # renamed after it was listed
            new = (path.stat() for path in unfinished_recordings(folder))
            return any(of.st_size > size for of in new if of.st_ino not in before)
        return False

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


def test_recording_of_a_killed_lift_is_kept_and_readable(killed: Path) -> None:
    [path] = unfinished_recordings(killed)
    assert path.name == "001.unfinished.mcap"
    assert recording_gaps(path) == []
    assert next(iter(phase_times(path))) == Phase.REFERENCE
    assert len(list(recorded_frames(path, "SIM-D0001"))) > 5
    assert not (killed / "lifts.jsonl").exists()
    entry = list_session(killed)
    assert (entry.state, entry.done, entry.problem) == (SessionState.UNFINISHED, 0, None)


def test_resumed_session_repeats_the_lift_and_keeps_the_interrupted_recording(
    killed: Path, two_lifts: Path, light_bench_file: Path
) -> None:
    first = (killed / "lifts" / "001.unfinished.mcap").read_bytes()
    with short_phases():
        done = rig(
            "trial", *SETTINGS, 1, "--jobs", 1, "--bench", light_bench_file, "--out", killed, "--resume"
        )
    assert done.returncode == 0, done.stderr
    (row,) = read_finished_lifts(killed)
    assert row.recording == "lifts/001.mcap"
    assert (killed / "lifts" / "001.interrupted-1.mcap").read_bytes() == first
    assert [path.name for path in unfinished_recordings(killed)] == ["001.interrupted-1.mcap"]
    assert (killed / row.recording).read_bytes() == (two_lifts / row.recording).read_bytes()


def test_angles_of_an_interrupted_recording_are_estimated_up_to_its_end(killed: Path, one_lift: Path) -> None:
    """The recording of a whole lift, cut off in phase C as a kill would."""
    whole = (one_lift / "lifts" / "001.mcap").read_bytes()
    unfinished = killed / "lifts" / "001.unfinished.mcap"
    unfinished.write_bytes(whole[: len(whole) * 8 // 10])
    done = answer("estimate", unfinished, "--sensor", "SIM-D0001", "--estimator", "pca")
    samples = done["samples"]
    assert sum(row["angle_deg"] is not None for row in samples) > 10
    assert "no finished lift; run the trial with --resume first" in refusal("replay", killed)
