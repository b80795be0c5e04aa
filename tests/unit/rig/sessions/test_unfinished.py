"""A recording is on disk during its lift, and keeps its unfinished name if the lift is interrupted."""

import os
import resource
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import OperatorStopError, RecordingError
from drivers.types import Frame
from rig.sessions import unfinished
from rig.sessions.recorder import LiftRecorder
from rig.sessions.records import LIFTS
from rig.sessions.session import open_session
from rig.sessions.unfinished import BackgroundFile, complete_at_end, new_recording
from support.recordings import trial_request, unfinished_recordings
from support.waiting import LIMIT_S

RECORDING = "lifts/007.mcap"
MB = 1_000_000


def frame(number: int, jpeg: bytes) -> Frame:
    return Frame(np.zeros((1, 1, 3), np.uint8), (1 + number) * 10_000_000, number, "T1", jpeg)


def record(recorder: LiftRecorder, frames: int, size: int = 20_000) -> None:
    for number in range(frames):
        recorder.frame(frame(number, os.urandom(size)))


def interrupt(recorder: LiftRecorder, file: BackgroundFile, frames: int) -> None:
    with complete_at_end(recorder, file):
        record(recorder, frames)
        raise OperatorStopError("stopped")


def writers() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("writer of")]


def test_frames_are_on_disk_during_the_lift(tmp_path: Path) -> None:
    file = new_recording(tmp_path, RECORDING)
    recorder = LiftRecorder(file)
    with complete_at_end(recorder, file):
        record(recorder, 100)
        deadline = time.monotonic() + 120.0
        while file.path.stat().st_size < 1.8 * MB and time.monotonic() < deadline:
            time.sleep(0.01)
        assert file.path == tmp_path / "lifts" / "007.unfinished.mcap"
        assert file.path.stat().st_size >= 1.8 * MB


def test_second_recording_of_a_lift_does_not_overwrite_the_first(tmp_path: Path) -> None:
    for frames in (3, 5):
        file = new_recording(tmp_path, RECORDING)
        recorder = LiftRecorder(file)
        with pytest.raises(OperatorStopError):
            interrupt(recorder, file, frames)
    names = [path.name for path in unfinished_recordings(tmp_path)]
    assert names == ["007.unfinished-2.mcap", "007.unfinished.mcap"]
    small, large = (tmp_path / "lifts" / name for name in reversed(names))
    assert 0 < small.stat().st_size < large.stat().st_size


def test_lift_without_messages_leaves_no_file(tmp_path: Path) -> None:
    file = new_recording(tmp_path, RECORDING)
    with pytest.raises(OperatorStopError), complete_at_end(LiftRecorder(file), file):
        raise OperatorStopError("stopped")
    assert list(tmp_path.iterdir()) == []
    assert writers() == []


def test_slow_disk_does_not_delay_the_caller_but_must_not_stall_for_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, disk = os.write, threading.Event()

    def slow(handle: int, data: bytes) -> int:
        assert disk.wait(LIMIT_S), "the caller waits for the disk"
        return write(handle, data)

    monkeypatch.setattr(unfinished.os, "write", slow)
    file, stalled = (BackgroundFile(iter([tmp_path / name])) for name in "ab")
    for _ in range(5):
        file.write(bytes(1000))
    with pytest.raises(RecordingError, match=r"b: the disk is too slow: 6[45] MB wait to be written"):
        deque(map(stalled.write, [bytes(MB)] * 70), maxlen=0)
    disk.set()
    file.close()
    stalled.close()
    assert (tmp_path / "a").stat().st_size == file.tell() == 5000
    assert writers() == []


@pytest.fixture
def small_disk() -> Iterator[None]:
    """Limit files of this process to 1 MB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MB, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("small_disk")
def test_full_disk_is_an_error_within_the_lift(tmp_path: Path) -> None:
    file = new_recording(tmp_path, RECORDING)
    recorder = LiftRecorder(file)
    sizes: list[int] = []

    def until_full() -> None:
        with complete_at_end(recorder, file):
            for number in range(500):
                recorder.frame(frame(number, bytes(20_000)))
                sizes.append(file.tell())
                time.sleep(0.001)

    with pytest.raises(RecordingError, match=r"007\.unfinished\.mcap: cannot be written"):
        until_full()
    assert max(sizes) < 4 * MB
    assert file.path.stat().st_size == MB
    assert writers() == []


def test_finished_recording_gets_its_name_and_an_unlisted_one_is_kept(tmp_path: Path) -> None:
    """The state after a crash between renaming a recording and appending its line."""
    with open_session(tmp_path / "s", trial_request(), LIFTS, resume=False) as session:
        lifts = session.folder / "lifts"
        lifts.mkdir()
        (lifts / "007.mcap").write_bytes(b"older")
        (lifts / "007.unfinished.mcap").write_bytes(b"newer")
        session.adopt("lifts/007.mcap", lifts / "007.unfinished.mcap")
        assert (lifts / "007.mcap").read_bytes() == b"newer"
        assert (lifts / "007.interrupted-1.mcap").read_bytes() == b"older"
        with pytest.raises(RecordingError, match=r"008\.mcap: cannot be written"):
            session.adopt("lifts/008.mcap", lifts / "008.unfinished.mcap")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (["007.unfinished"], ["007.interrupted-1"]),
        (["007.unfinished", "007.unfinished-2"], ["007.interrupted-1", "007.interrupted-2"]),
        (["007.interrupted-1", "007.unfinished"], ["007.interrupted-1", "007.interrupted-2"]),
        (["007-attempt1.unfinished", "008.unfinished"], ["007-attempt1.interrupted-1", "008.interrupted-1"]),
        (["006", "007-attempt1"], ["006", "007-attempt1"]),
    ],
)
def test_resumed_session_leaves_no_unfinished_recording(
    before: list[str], after: list[str], tmp_path: Path
) -> None:
    with open_session(tmp_path / "s", trial_request(), LIFTS, resume=False) as session:
        lifts = session.folder / "lifts"
        lifts.mkdir()
        for name in before:
            (lifts / f"{name}.mcap").write_bytes(name.encode())
    with open_session(tmp_path / "s", trial_request(), LIFTS, resume=True):
        assert sorted(path.stem for path in lifts.iterdir()) == sorted(after)
        assert {path.read_bytes().decode() for path in lifts.iterdir()} == set(before)
