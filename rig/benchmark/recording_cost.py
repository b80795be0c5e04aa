"""Time that recording a frame takes from the control loop.

`python -m rig.benchmark.recording_cost FOLDER`. Frames come at a bench's rates and sizes, and their
recording is timed in the calling thread: into a file that a thread of its own writes, as lifts are recorded,
into a file that the caller writes itself, and into memory, which shows what a loaded host adds.
"""

import io
import os
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.types import Frame
from rig.sessions.recorder import LiftRecorder, Sink
from rig.sessions.unfinished import BackgroundFile

SECONDS = 15.0
SOURCES = (("T1", 60.0, 25_000), ("T2", 60.0, 25_000), ("CAM", 30.0, 60_000))
"""Serial, rate in Hz, bytes of a frame: two fingertips at full size, one camera."""


@dataclass(frozen=True, slots=True)
class FrameCost:
    """Time per recorded frame in the calling thread, ms: by the clock, and of the processor (cpu_p99_ms)."""

    median_ms: float
    p99_ms: float
    max_ms: float
    cpu_p99_ms: float
    frames: int
    size: int


def time_frames(sink: Sink, seconds: float = SECONDS) -> FrameCost:
    """Record frames in real time. Raises `RecordingError` if they cannot be written."""
    due = sorted(
        (n / rate, serial, n, size) for serial, rate, size in SOURCES for n in range(int(rate * seconds))
    )
    image, noise = np.zeros((1, 1, 3), np.uint8), os.urandom(max(size for _, _, size in SOURCES))
    took_ms: list[float] = []
    cpu_ms: list[float] = []
    recorder, began = LiftRecorder(sink), time.perf_counter()
    for time_s, serial, number, size in due:
        time.sleep(max(began + time_s - time.perf_counter(), 0.0))
        frame = Frame(image, round(time_s * 1e9), number, serial, noise[:size])
        start, start_cpu = time.perf_counter(), time.thread_time()
        recorder.frame(frame)
        took_ms.append(1e3 * (time.perf_counter() - start))
        cpu_ms.append(1e3 * (time.thread_time() - start_cpu))
    recorder.close()
    median, p99 = np.percentile(took_ms, (50, 99))
    return FrameCost(
        float(median), float(p99), max(took_ms), float(np.percentile(cpu_ms, 99)), len(took_ms), sink.tell()
    )


def main(folder: Path) -> None:
    """Print the cost of both ways of writing below a folder, on whose disk they are measured."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        with closing(BackgroundFile([Path(name, "thread.mcap")])) as background:
            _print("thread of its own", time_frames(background))
        with Path(name, "caller.mcap").open("wb", buffering=0) as direct:
            _print("caller writes", time_frames(direct))
        _print("memory", time_frames(io.BytesIO()))


def _print(how: str, cost: FrameCost) -> None:
    print(
        f"{how}: median {cost.median_ms:.3f} ms, 99 % {cost.p99_ms:.2f} ms, max {cost.max_ms:.2f} ms "
        f"(99 % of processor time {cost.cpu_p99_ms:.2f} ms) of {cost.frames} frames, {cost.size / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
