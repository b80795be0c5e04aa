"""Frames of a simulated fingertip on a desk, drawn at chosen times, and a source of given frames."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from drivers.clock import SystemClock, to_ns
from drivers.errors import DeviceError
from drivers.images import with_jpeg
from drivers.interfaces import FrameSource
from drivers.types import Frame
from fakes.devices.desk import Demonstration, DeskDigit
from rig.live.clip_writer import ClipWriter

RATE_HZ = 30.0


def desk_digit(side: int = 1) -> DeskDigit:
    """Return a fingertip whose first cycle begins at 0."""
    return DeskDigit(f"DESK{side}", side, Demonstration(0), SystemClock())


def desk_frames(until_s: float, side: int = 1, from_s: float = 2.0, every: int = 1) -> Iterator[Frame]:
    """Yield frames of 30 per second, every nth; the first touch is at 3 s, the first turn at 6 s."""
    digit = desk_digit(side)
    for number in range(0, round((until_s - from_s) * RATE_HZ), every):
        time_ns = to_ns(from_s + number / RATE_HZ)
        image = digit.draw(time_ns, np.random.default_rng(number))
        yield with_jpeg(Frame(image, time_ns, number, digit.serial))


def write_desk_clip(folder: Path, until_s: float, every: int = 1) -> list[Frame]:
    """Write frames of `desk_frames` into a SIMULATED clip, with a mark 2 s after the first; return them."""
    frames = list(desk_frames(until_s, every=every))
    with closing(ClipWriter(folder, frames[0].image, {"sensor": "D1", "simulated": True})) as clip:
        for frame in frames:
            clip.add(frame)
        clip.mark(frames[0].time_ns + to_ns(2.0), "mark 1")
    return frames


class GivenFrames(FrameSource):
    """Hands out frames at once, with their own intervals from now on, and then ends as a file does."""

    waits = True

    def __init__(self, frames: Sequence[Frame], serial: str = "GIVEN", rate_hz: float = RATE_HZ) -> None:
        self._frames, self.serial, self.rate_hz = list(frames), serial, rate_hz
        self.connected = False
        self._later_ns: int | None = None

    def connect(self) -> None:
        self.connected = True

    def disconnect(self) -> None:
        self.connected = False

    def next_frame(self, timeout_s: float) -> Frame:
        if not self._frames:
            raise DeviceError(f"{self.serial}: all images have been played; start again")
        frame = self._frames.pop(0)
        if self._later_ns is None:
            self._later_ns = SystemClock().now_ns() - frame.time_ns
        return Frame(frame.image, frame.time_ns + self._later_ns, frame.sequence, self.serial, frame.jpeg)

    def newest_frame(self, max_age_s: float) -> Frame:
        return self.next_frame(max_age_s)
