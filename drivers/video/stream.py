"""An open source of frames before they are decoded: its raw frames, their capture times and numbers."""

from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Protocol

from drivers.clock import NS_PER_S
from drivers.types import Image

MAX_DELAY_NS = NS_PER_S
"""A first stamp this much older than its arrival, or newer, is of another clock than ours."""
_INTERVALS = 31
_ENOUGH = 8


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One image as it came: encoded bytes or pixels, never both.

    encoded: a JPEG, from files also a PNG. image: (H, W, 3) uint8 RGB. arrived_ns: monotonic
    time at which the last byte was here. stamped_ns: capture time the source gives, ns of a
    clock it does not name. number: how many images the source has captured, where it counts.
    """

    arrived_ns: int
    encoded: bytes | None = None
    image: Image | None = None
    stamped_ns: int | None = None
    number: int | None = None


class FrameStream(Protocol):
    """An open source. One thread reads and closes it, any other may interrupt it."""

    warm_up: int
    """Images to discard after opening, while exposure and light settle."""
    stamp: str
    """Who gives `stamped_ns`: "kernel", "peer" or "schedule"."""
    ends: bool
    """Whether it has a last image, as a file has; it is not opened again then."""

    def read(self) -> RawFrame:
        """Wait for the next image. Raises `DeviceError` when no more will come."""
        ...

    def interrupt(self) -> None:
        """End a `read` in progress if that can be done; it raises `DeviceError` then."""
        ...

    def close(self) -> None:
        """Let the source go. Safe to call twice."""
        ...


class CaptureTimes:
    """Chooses the capture time of one stream's images: the source's stamp, or the arrival.

    The first stamp decides: within a second before its arrival, it is of our own monotonic
    clock; anything else is another clock (a remote computer's, or the time of day).
    """

    def __init__(self, stamp: str) -> None:
        self._stamp = stamp
        self._trusted: bool | None = None
        self._last_ns = -1

    @property
    def kind(self) -> str:
        """What the times are: "kernel", "peer", "schedule", or "arrival"."""
        return self._stamp if self._trusted else "arrival"

    def time_of(self, raw: RawFrame) -> int:
        """Return an image's capture time, monotonic ns, later than the one before."""
        stamped = raw.stamped_ns
        if self._trusted is None:
            self._trusted = stamped is not None and 0 <= raw.arrived_ns - stamped < MAX_DELAY_NS
        usable = self._trusted and stamped is not None and self._last_ns < stamped <= raw.arrived_ns
        time_ns = stamped if usable and stamped is not None else raw.arrived_ns
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns


class SequenceCounter:
    """Gives each image its sequence number; counts the images that never came.

    The source's own numbers decide where it has any; else the capture times, where the source
    stamps them: an interval of about n periods means n - 1 drops. Arrival times say nothing,
    for an image may just have been late. rate_hz: what an interruption is counted with.
    """

    def __init__(self, rate_hz: float) -> None:
        self.dropped = 0
        self._rate_hz = rate_hz
        self._last: int | None = None
        self._last_ns = 0
        self._offset = 0
        self._interrupted = False
        self._gap_counts = True
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def opened(self, after_failure: bool) -> None:
        """The source was opened: its frame numbers may restart.

        after_failure: then the images since the last one count as dropped.
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
