"""An open frame source: its raw frames before decoding, their capture times and sequence numbers."""

from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Protocol

from drivers.clock import NS_PER_S
from drivers.types import Image

MAX_DELAY_NS = NS_PER_S
"""If the first time stamp is older than its arrival by more than this, or newer, it is from another clock."""
_INTERVALS = 31
"""Number of newest frame intervals of which the median is taken."""
_ENOUGH = 8
"""Fewest intervals before the median is used."""


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One image as received: either encoded bytes or pixels.

    encoded: a JPEG; from files also a PNG. image: (H, W, 3) uint8 RGB. arrived_ns: monotonic time at which
    the last byte was received. stamped_ns: capture time from the source, ns of an unspecified clock. number:
    number of images captured by the source, if it counts them.
    """

    arrived_ns: int
    encoded: bytes | None = None
    image: Image | None = None
    stamped_ns: int | None = None
    number: int | None = None


class FrameStream(Protocol):
    """An open source. One thread reads and closes it; any other thread may interrupt it."""

    warm_up: int
    """Number of images to discard after opening, while exposure and LEDs settle."""
    stamp: str
    """Origin of `stamped_ns`: "kernel", "peer" or "schedule"."""
    ends: bool
    """Whether the source has a last image, as a file has; it is then not reopened."""

    def read(self) -> RawFrame:
        """Wait for the next image. Raises `DeviceError` if no more images will arrive."""
        ...

    def interrupt(self) -> None:
        """End a `read` in progress, if possible; it then raises `DeviceError`."""
        ...

    def close(self) -> None:
        """Close the source. Safe to call twice."""
        ...


class CaptureTimes:
    """Chooses the capture time of each image of a stream: the source's time stamp, or the arrival time.

    The first time stamp decides. If it is at most a second before its arrival, it is from this computer's
    monotonic clock; otherwise it is from another clock (of a remote computer, or the time of day).
    """

    def __init__(self, stamp: str) -> None:
        self._stamp = stamp
        self._trusted: bool | None = None
        self._last_ns = -1

    @property
    def kind(self) -> str:
        """Origin of the times: "kernel", "peer", "schedule", or "arrival"."""
        return self._stamp if self._trusted else "arrival"

    def time_of(self, raw: RawFrame) -> int:
        """Return an image's capture time, monotonic ns; always later than that of the previous image."""
        stamped = raw.stamped_ns
        if self._trusted is None:
            self._trusted = stamped is not None and 0 <= raw.arrived_ns - stamped < MAX_DELAY_NS
        usable = self._trusted and stamped is not None and self._last_ns < stamped <= raw.arrived_ns
        time_ns = stamped if usable and stamped is not None else raw.arrived_ns
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns


class SequenceCounter:
    """Numbers the images of a source and counts dropped ones.

    The source's own numbers are used if it has any. Otherwise, if the source provides capture times, an
    interval of about n periods means n - 1 dropped images. Arrival times are not used, because a late image
    is not a dropped one. rate_hz: frame rate with which images during an interruption are counted.
    """

    def __init__(self, rate_hz: float) -> None:
        self.dropped = 0
        self._rate_hz = rate_hz
        self._last: int | None = None
        self._last_ns = self._offset = 0
        self._interrupted = False
        self._gap_counts = True
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def opened(self, after_failure: bool) -> None:
        """Note that the source was opened: its frame numbers may restart.

        after_failure: images since the last one count as dropped.
        """
        self._interrupted = self._last is not None
        self._gap_counts = after_failure or self._last is None
        self._intervals.clear()

    def sequence_of(self, number: int | None, time_ns: int, stamped: bool) -> int:
        """Return an image's sequence number. stamped: whether `time_ns` is its capture time."""
        interval_ns, self._last_ns = time_ns - self._last_ns, time_ns
        if self._last is None:
            self._last = number or 0
            return self._last
        step = self._step(self._last, number, interval_ns, stamped)
        self.dropped += step - 1 if self._gap_counts else 0
        self._interrupted, self._gap_counts = False, True
        self._intervals.append(max(interval_ns // step, 1))
        self._last += step
        return self._last

    def _step(self, last: int, number: int | None, interval_ns: int, stamped: bool) -> int:
        if number is not None and number + self._offset > last:
            return number + self._offset - last
        step = 1
        if self._interrupted:
            step = max(round(interval_ns * self._rate_hz / NS_PER_S), 2)
        elif number is None and stamped and len(self._intervals) >= _ENOUGH:
            periods = interval_ns / median(self._intervals)
            step = round(periods) if periods > 1.6 else 1
        self._offset = 0 if number is None else last + step - number
        return step
