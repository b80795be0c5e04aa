"""Frame statistics of a source: received, dropped, repeated, frozen, and frames with an invalid time."""

from collections import deque
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import StaleFrameError
from drivers.interfaces import FrameSource
from drivers.types import Frame, Image

LONGEST_STEP_NS, MOST_STEPS = NS_PER_S // 2, 20
"""A frame time is valid if it is at most this far, or MOST_STEPS frame intervals, from the previous one."""
AGREEING_NS = 2 * NS_PER_S
"""Two successive outliers agree if they are at most this far, or MOST_STEPS frame intervals, apart."""

FROZEN_NS, FROZEN_REPEATS = LONGEST_STEP_NS, 3
"""A source has frozen if its last new picture is older than this, and at least this many repeats followed it.
A video that was converted to a higher rate repeats each picture for a shorter time; across a longer one, no
rotation can be followed. The number of repeats is for streams with few frames per second."""
FEW_SHARE = 0.015
"""A picture of which fewer pixels differ from an earlier one is its copy, also in a stream without noise. One
changed pixel changes up to 0.7 % of a JPEG of 320 x 240 px. In rotation_clips and marker_slip_clips, from
which a video codec has removed the noise, fewer differ for 0.1 s at most."""
NOISE_SHARE = 0.8
"""A picture that differs by less than this share of the usual noise is a copy. Live SIMULATED pictures, as
JPEG of quality 80 to 100, differ by 1.05 to 1.6 of it; one picture encoded again by 0.1 (quality 96) to 0.77
(quality 90)."""
LEARNT_PICTURES, MOST_UNSTEADY = 16, 1.5
"""The usual noise is the lower quartile over this many new pictures, because the first copies of one may
be among them. It is unknown if the largest is more than MOST_UNSTEADY times as large, as after video
compression or while the light changes."""
COMPARED_PICTURES = 3
"""A picture is compared with this many earlier ones, to recognise a few encodings of one picture in turn."""
SELDOM_NS = NS_PER_S // 10
"""Interval of the pictures that an estimator compares, once the usual noise is known: all would take 0.1 ms
each."""
SAMPLES, BLOCK = 80, 8
"""About this many pixels are compared along the long side of a picture, in blocks with this side."""
QUIET, BUSY = 0.25, 0.9
"""The noise is that of the quietest quarter of the blocks. A copy differs by less than the noise in 90 % of
the blocks, so that a motion in a tenth of the picture makes it new."""


class StreamTimes:
    """Detects frames whose capture time has jumped.

    The first frame whose time is far from that of the previous frame is an outlier. If the next frame agrees
    with the outlier, the stream has paused or restarted, and is followed from there. So a single wrong time
    costs one frame, and a pause costs the first frame after it.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._aside_ns: int | None = None
        self._step_ns: int | None = None
        self.sparse = False
        """Whether the newest two frames are too far apart for a motion between them to be followed."""

    def follows(self, time_ns: int) -> bool:
        """Add the time of the next frame; return whether it is valid. Small delays and repeats are valid."""
        last = self._last_ns
        if last is None or self._step_ns is None:
            jumped = last is not None and time_ns < last - LONGEST_STEP_NS and self._aside_ns is None
        else:
            jumped = self._is_far(time_ns, last, LONGEST_STEP_NS) and (
                self._aside_ns is None or self._is_far(time_ns, self._aside_ns, AGREEING_NS)
            )
        if jumped:
            self._aside_ns = time_ns
            return False
        before = last if self._aside_ns is None else self._aside_ns
        # after a pause, or a single wrong time, one of the two is near
        self.sparse = all(near is not None and time_ns - near > LONGEST_STEP_NS for near in (last, before))
        if before is None or time_ns > before:
            self._step_ns = None if before is None else time_ns - before
        self._last_ns, self._aside_ns = time_ns, None
        return True

    def _is_far(self, time_ns: int, from_ns: int, at_least_ns: int) -> bool:
        furthest = max(at_least_ns, MOST_STEPS * (self._step_ns or 0))
        return abs(time_ns - from_ns) > furthest


class PictureNews:
    """Whether the pictures of a stream are new, or copies of earlier ones; the only definition of frozen.

    The noise of a live sensor changes nearly every pixel of each picture. A frozen source delivers one
    picture again: bit for bit, with a few other pixels, or encoded again. So a new picture differs from the
    earlier ones by the usual noise of its stream.

    every_ns: interval of the pictures that are compared once the usual noise is known; 0 for all. If one of
    them is a copy, those between are compared, too, so that `frozen` begins at the same picture. `repeated`
    is that of the newest compared picture.
    """

    def __init__(self, every_ns: int = 0) -> None:
        self._every_ns, self._compared_ns = every_ns, 0
        self._waiting: list[tuple[Image, int]] = []
        self.repeated = False
        """Whether the newest picture is a copy of an earlier one."""
        self.frozen = False
        """Whether the source has frozen: see `FROZEN_NS`."""
        self._earlier = deque[Image](maxlen=COMPARED_PICTURES)
        self._noise = deque[float](maxlen=LEARNT_PICTURES)
        self._repeats, self._new_ns = 0, 0

    def add(self, image: Image, time_ns: int) -> None:
        """Process the next picture, (H, W, 3) uint8 RGB, and its capture time."""
        step = max(image.shape[:2]) / SAMPLES
        height, width = (BLOCK * max(1, round(side / step / BLOCK)) for side in image.shape[:2])
        # single pixels on a grid, whose sides are multiples of BLOCK
        seen = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
        self._waiting.append((seen, time_ns))
        seldom = len(self._noise) == LEARNT_PICTURES and not self.repeated
        if seldom and 0 <= time_ns - self._compared_ns < self._every_ns:
            return
        self._compared_ns, waiting, self._waiting = time_ns, self._waiting, []
        if len(waiting) == 1 or not self._compare(seen, time_ns, [picture for picture, _ in waiting[:-1]]):
            for picture, taken_ns in waiting:
                self._compare(picture, taken_ns)
        self.frozen = self._repeats >= FROZEN_REPEATS and time_ns - self._new_ns > FROZEN_NS

    def _compare(self, seen: Image, time_ns: int, between: Sequence[Image] = ()) -> bool:
        """Record whether a picture is new; return whether it is.

        between: pictures since the last compared one; if there are any, a copy is not recorded.
        """
        recent = [*self._earlier, *between][-COMPARED_PICTURES:]
        earlier = [old for old in recent if old.shape == seen.shape]
        shares, quiet, busy = _changes(seen, earlier) if earlier else ([1.0], [], [np.inf])
        if min(shares) < FEW_SHARE or min(busy) < NOISE_SHARE * self._usual_noise():
            if not between:
                self.repeated, self._repeats = True, self._repeats + 1
            return False
        self.repeated, self._repeats, self._new_ns = False, 0, time_ns
        self._earlier.extend([*between, seen])
        self._noise.extend([min(quiet)] if earlier else [])
        return True

    def require_live(self, serial: str) -> None:
        """Raise `StaleFrameError` if the source with this serial has frozen."""
        if self.frozen:
            raise StaleFrameError(
                f"{serial}: it has repeated its picture for {FROZEN_NS / NS_PER_S:g} s, it has frozen; check "
                "its cable, replug it, then start again"
            )

    def _usual_noise(self) -> float:
        """Return the usual noise of the stream, grey levels; 0 if it is unknown."""
        if len(self._noise) < LEARNT_PICTURES:
            return 0.0
        noise = sorted(self._noise)
        quartile = noise[LEARNT_PICTURES // 4]
        return quartile if noise[-1] <= MOST_UNSTEADY * quartile else 0.0


def new_pictures(source: FrameSource, max_age_s: float, timeout_s: float) -> Iterator[Frame]:
    """Yield the next frames of a connected source without copies of earlier pictures.

    A copy is left out because its time is not the time at which its picture was taken. max_age_s: largest
    age of the newest frame at the start. timeout_s: time limit for each next frame. Raises `StaleFrameError`
    if the stream has stopped or frozen, `DeviceTimeoutError` if a frame is late.
    """
    news, frame = PictureNews(), source.newest_frame(max_age_s)
    news.add(frame.image, frame.time_ns)
    while True:
        frame = source.next_frame(timeout_s)
        news.add(frame.image, frame.time_ns)
        news.require_live(source.serial)
        if not news.repeated:
            yield frame


def _changes(image: Image, earlier: list[Image]) -> tuple[list[float], list[float], list[float]]:
    """Compare a picture with earlier ones of its size, at least one.

    Returns for each of them the share of changed values, and the mean change of a quiet and of a busy block,
    grey levels.
    """
    height, _, channels = image.shape
    changes = [cv2.absdiff(image, old).reshape(height, -1) for old in earlier]
    shares = [cv2.countNonZero(change) / image.size for change in changes]
    # an integral image, because sums over single blocks take several times as long
    corners = cv2.integral(np.concatenate(changes))[::BLOCK, :: BLOCK * channels]
    sums = np.sort(np.diff(np.diff(corners, axis=0), axis=1).reshape(len(earlier), -1))
    places = [round(share * (sums.shape[1] - 1)) for share in (QUIET, BUSY)]
    quiet, busy = (sums[:, places].T / (BLOCK**2 * channels)).tolist()
    return shares, quiet, busy


class FrameTally:
    """Counts the frames of one source, in order; the only definition of dropped and jumped.

    frames: number received. dropped: number missing between the first and the newest frame, from gaps in
    `Frame.sequence`. jumped: number with an invalid time, see `StreamTimes`.
    """

    def __init__(self) -> None:
        self.frames = self.dropped = self.jumped = 0
        self.out_of_time = False
        """Whether the newest frame's time jumped, so that it is not the time at which the image was taken."""
        self._times = StreamTimes()
        self._last: Frame | None = None

    def add(self, frame: Frame) -> None:
        last, self._last = self._last, frame
        self.frames += 1
        self.out_of_time = not self._times.follows(frame.time_ns)
        self.jumped += self.out_of_time
        if last is not None:
            self.dropped += frame.sequence - last.sequence - 1
