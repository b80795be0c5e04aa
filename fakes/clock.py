"""Clocks of the simulated bench: simulated time that passes as fast as possible, or real time."""

import time

from drivers.clock import NS_PER_S, SystemClock


class SimulatedClock:
    """A clock whose time advances when a caller sleeps.

    With `realtime` the time also advances with the computer's clock, so that a simulated lift can be watched
    and its load on the computer measured.
    """

    def __init__(self, realtime: bool = False) -> None:
        self._realtime = realtime
        self._now_ns = 0
        self._started_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the simulated time since the bench was made, ns."""
        if self._realtime:
            self._now_ns = max(self._now_ns, time.monotonic_ns() - self._started_ns)
        return self._now_ns

    def sleep_until(self, time_ns: int) -> None:
        """Advance the simulated time to `time_ns`."""
        remaining_ns = time_ns - self.now_ns()
        if remaining_ns <= 0:
            return
        if self._realtime:
            time.sleep(remaining_ns / NS_PER_S)
        self._now_ns = max(self._now_ns, time_ns)


class SharedClock(SystemClock):
    """Time since `start_ns` on a system clock of a slowness, equal in all processes with the same two."""

    def __init__(self, start_ns: int, slowness: int = 1) -> None:
        super().__init__(slowness)
        self.start_ns = start_ns

    @classmethod
    def start(cls, slowness: int = 1) -> "SharedClock":
        return cls(SystemClock(slowness).now_ns(), slowness)

    def now_ns(self) -> int:
        return super().now_ns() - self.start_ns
