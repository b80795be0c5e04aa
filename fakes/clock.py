"""The simulated bench's clock: the same code path as real time, as fast as the machine allows."""

import time

from drivers.clock import NS_PER_S


class SimulatedClock:
    """Time that passes when somebody waits for it.

    With `realtime` it also passes by itself, at the pace of the computer's clock, so that a
    simulated lift can be watched and the loop's real load measured.
    """

    def __init__(self, realtime: bool = False) -> None:
        self._realtime = realtime
        self._now_ns = 0
        self._started_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Simulated time since the bench was made, ns."""
        if self._realtime:
            self._now_ns = max(self._now_ns, time.monotonic_ns() - self._started_ns)
        return self._now_ns

    def sleep_until(self, time_ns: int) -> None:
        """Let simulated time pass until `time_ns`."""
        remaining_ns = time_ns - self.now_ns()
        if remaining_ns <= 0:
            return
        if self._realtime:
            time.sleep(remaining_ns / NS_PER_S)
        self._now_ns = max(self._now_ns, time_ns)


class SharedClock:
    """Time since `start_ns` of the computer's monotonic clock, the same for all processes told so."""

    def __init__(self, start_ns: int) -> None:
        self.start_ns = start_ns

    def now_ns(self) -> int:
        """Time since the start, ns."""
        return time.monotonic_ns() - self.start_ns

    def sleep_until(self, time_ns: int) -> None:
        """Sleep until the given time."""
        remaining_ns = time_ns - self.now_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns / NS_PER_S)
