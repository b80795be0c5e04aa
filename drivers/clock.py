"""Time. Nothing in the rig sleeps or reads the time except through a `Clock`."""

import time
from collections.abc import Callable
from typing import Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """A monotonic clock in integer nanoseconds."""

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        ...

    def sleep_until(self, time_ns: int) -> None:
        """Return when `now_ns() >= time_ns`; immediately if that time has passed."""
        ...


class SystemClock:
    """The computer's monotonic clock."""

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        return time.monotonic_ns()

    def sleep_until(self, time_ns: int) -> None:
        """Sleep until the given monotonic time."""
        remaining_ns = time_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns / NS_PER_S)


def to_ns(duration_s: float) -> int:
    """Convert a duration in s to integer ns."""
    return round(duration_s * NS_PER_S)


def wait_until(clock: Clock, met: Callable[[], bool], timeout_s: float, poll_s: float) -> bool:
    """Poll `met` every `poll_s` until it is true; return False if `timeout_s` pass first."""
    deadline = clock.now_ns() + to_ns(timeout_s)
    while not met():
        if clock.now_ns() >= deadline:
            return False
        clock.sleep_until(clock.now_ns() + to_ns(poll_s))
    return True
