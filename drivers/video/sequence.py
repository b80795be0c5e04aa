"""Numbers a source's images so that a gap is a drop."""

from collections import deque
from statistics import median

from drivers.clock import NS_PER_S

_INTERVALS = 31
_ENOUGH = 8


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
        """The source was opened: its numbers may begin anew.

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
