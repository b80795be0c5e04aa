"""Small pictures of frames for those who look on, no more of them than somebody can see."""

import os

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.images import encode_jpeg
from drivers.types import Frame, Image
from rig.live.feed import LiveFeed, Sender

MOST_PER_S = 10.0
"""Pictures of one source, and sets of figures, in a second of real time."""
PICTURE_LONG_SIDE_PX = 320
PICTURE_QUALITY = 80


class Sparing:
    """Lets each thing through at most `MOST_PER_S` times in a second of the clock, by default a real one."""

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self._passed_ns: dict[str, int] = {}

    def due(self, what: str) -> bool:
        """Whether enough time has passed since it last went through; if so, it goes through now."""
        now = self._clock.now_ns()
        if now - self._passed_ns.get(what, -NS_PER_S) < NS_PER_S / MOST_PER_S:
            return False
        self._passed_ns[what] = now
        return True


class PictureSender:
    """Sends small pictures of frames to those who look on, where no lift is measured."""

    def __init__(self, feed: LiveFeed) -> None:
        self._sender, self._pictures = Sender(feed), feed.pictures
        self._sparing = Sparing()

    def __call__(self, frame: Frame) -> None:
        """Send a frame, unless one of its source was sent just now, or nobody looks on."""
        if self._pictures and self._sparing.due(frame.serial):
            values = {"serial": frame.serial, "time_ns": frame.time_ns, "sender": os.getpid()}
            self._sender.send("frame", values, small_jpeg(frame.image)[0])

    def close(self) -> None:
        """Let go of the socket."""
        self._sender.close()


def small_jpeg(image: Image) -> tuple[bytes, float]:
    """Return the JPEG of a picture no larger than a viewer needs, and its scale."""
    scale = min(1.0, PICTURE_LONG_SIDE_PX / max(image.shape[:2]))
    if scale < 1.0:
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        image = np.asarray(small, np.uint8)
    return encode_jpeg(image, PICTURE_QUALITY), scale
