"""Brings every sensor's frames to the watch, in the order they were captured."""

from collections.abc import Callable

import numpy as np

from drivers.bench import Bench
from drivers.clock import NS_PER_S, seconds
from drivers.errors import DeviceTimeoutError, StaleFrameError
from drivers.interfaces import FrameSource
from drivers.types import Frame
from protocols.watch import Watch

FRAME_TIMEOUT_S = 0.25
FROZEN_FRAMES = 20
"""A live sensor has noise: this many identical frames in a row mean that it froze."""


class Pump:
    """Reads the sources one by one, always the one whose next frame is due first.

    A single reader keeps the order of frames, and with it every result, the same on each run;
    the sources' backlogs hold what arrives meanwhile.
    """

    def __init__(self, bench: Bench, watch: Watch) -> None:
        self._bench = bench
        self._watch = watch
        self._streams = [_Stream(source) for source in bench.frame_sources]

    def start(self) -> None:
        """Skip what was captured before now."""
        self._bench.clock.sleep_until(self._bench.clock.now_ns() + seconds(0.05))
        for stream in self._streams:
            stream.accept(stream.source.newest_frame(max_age_s=FRAME_TIMEOUT_S))

    def run_for(self, duration_s: float) -> None:
        """Deliver frames for a while."""
        end = self._bench.clock.now_ns() + seconds(duration_s)
        self.run_until(lambda: self._bench.clock.now_ns() >= end, duration_s + 1.0)

    def run_until(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Deliver frames until `done`. Raises `DeviceTimeoutError`, or what a source raises."""
        deadline = self._bench.clock.now_ns() + seconds(timeout_s)
        while not done():
            if self._bench.clock.now_ns() > deadline:
                raise DeviceTimeoutError(f"bench: still not done after {timeout_s:.1f} s; stopped waiting")
            self._deliver(min(self._streams, key=lambda stream: stream.due_ns))

    def _deliver(self, stream: "_Stream") -> None:
        frame = stream.source.next_frame(FRAME_TIMEOUT_S)
        stream.accept(frame)
        if stream.source is self._bench.camera:
            # What is wrong with the arm or the gripper shows here, whatever the lift is waiting for.
            self._watch.arm(self._bench.arm.state())
            self._watch.gripper(self._bench.gripper.state())
        self._watch.frame(frame)


class _Stream:
    """One source, when its next frame is due, and how often it repeated itself."""

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self.due_ns = 0
        self._last: Frame | None = None
        self._repeats = 0

    def accept(self, frame: Frame) -> None:
        same = self._last is not None and _same_picture(frame, self._last)
        self._repeats = self._repeats + 1 if same else 0
        if self._repeats >= FROZEN_FRAMES:
            raise StaleFrameError(
                f"{self.source.serial}: {FROZEN_FRAMES} identical frames in a row, the sensor froze; "
                "replug it, then start again"
            )
        self._last = frame
        self.due_ns = frame.time_ns + round(NS_PER_S / self.source.rate_hz)


def _same_picture(one: Frame, other: Frame) -> bool:
    """Whether two frames are equal to the last bit; their encoded bytes tell at once."""
    if one.jpeg is not None and other.jpeg is not None:
        return one.jpeg == other.jpeg
    return np.array_equal(one.image, other.image)
