"""Capture frames of a scene at rest: nothing moves, frames are captured one after the other."""

from collections.abc import Callable

from drivers.bench import Bench
from drivers.interfaces import FrameSource
from drivers.types import Frame
from protocols.capture_hand_eye import wait_until_still

FRAME_AGE_S = 0.25
"""Largest age of the newest frame before the capture starts; an older one means a stopped stream."""
FRAME_TIMEOUT_S = 1.0
"""Time limit for the next frame."""


def capture_still(
    bench: Bench, source: FrameSource, count: int, shown: Callable[[Frame], None] | None = None
) -> list[Frame]:
    """Capture `count` frames of a source after the arm has come to rest; moves nothing.

    shown: called with each frame. Raises `DeviceTimeoutError` if the arm does not come to rest or a frame is
    late.
    """
    wait_until_still(bench)
    source.newest_frame(FRAME_AGE_S)
    frames = []
    for _ in range(count):
        frames.append(source.next_frame(FRAME_TIMEOUT_S))
        if shown is not None:
            shown(frames[-1])
    return frames
