"""Pictures of something at rest: nothing moves, frames are taken one after the other."""

from collections.abc import Callable

from drivers.bench import Bench
from drivers.interfaces import FrameSource
from drivers.types import Frame
from protocols.capture_hand_eye import wait_until_still

FRAME_AGE_S = 0.25
FRAME_TIMEOUT_S = 1.0


def capture_still(
    bench: Bench, source: FrameSource, count: int, shown: Callable[[Frame], None] | None = None
) -> list[Frame]:
    """Take `count` frames of a source once the arm stands still; moves nothing.

    shown: is given each frame as it comes. Raises `DeviceTimeoutError` where the arm does not come to rest
    or a frame is late.
    """
    wait_until_still(bench)
    source.newest_frame(FRAME_AGE_S)
    frames = []
    for _ in range(count):
        frames.append(source.next_frame(FRAME_TIMEOUT_S))
        if shown is not None:
            shown(frames[-1])
    return frames
