"""Messages are in order of arrival, followed by angles in their order; each keeps its time."""

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from drivers.types import Frame
from rig.sessions.reading import recorded_angles
from rig.sessions.recorder import LiftRecorder, image_topic
from rig.sessions.recording_file import recorded_messages
from rig.tactile.angles import FUSED, Angles

MS = 1_000_000
HOUR_MS = 3_600_000


def frame(serial: str, time_ms: int, sequence: int) -> Frame:
    return Frame(np.zeros((1, 1, 3), np.uint8), time_ms * MS, sequence, serial, b"jpeg")


@pytest.mark.parametrize("wrong_ms", [110, 60, 110 + HOUR_MS], ids=["none", "early", "an hour ahead"])
def test_log_times_increase_over_frames_and_again_over_angles(tmp_path: Path, wrong_ms: int) -> None:
    stream = io.BytesIO()
    recorder = LiftRecorder(stream)
    arrived = [("T1", 100), ("CAM", 90), ("T1", wrong_ms), ("CAM", 120), ("T1", 130)]
    for number, (serial, time_ms) in enumerate(arrived):
        recorder.frame(frame(serial, time_ms, number))
    for source, times_s in ((FUSED, [0.1, 0.13]), ("T1", [0.09, 0.12])):
        recorder.angles(Angles(np.array(times_s), np.ones(2), np.ones(2), ("tracking",) * 2, source=source))
    recorder.close()
    path = tmp_path / "001.mcap"
    path.write_bytes(stream.getvalue())

    messages = list(make_reader(io.BytesIO(path.read_bytes())).iter_messages(log_time_order=False))
    log_times = [message.log_time for _, _, message in messages]
    frames, angles = log_times[:5], log_times[5:]
    assert frames == sorted(frames)
    assert angles == [90 * MS, 100 * MS, 120 * MS, 130 * MS]
    assert frames[-1] <= 130 * MS + 1_000 * MS  # one wrong stamp moves no other message by an hour
    images = [(t, time_ns) for t, time_ns, _, _ in recorded_messages(path) if t.startswith("/image/")]
    assert images == [(image_topic(serial), time_ms * MS) for serial, time_ms in arrived]
    assert recorded_angles(path, FUSED)[FUSED].time_ns.tolist() == [100 * MS, 130 * MS]
