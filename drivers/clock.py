"""Time. Nothing in the rig sleeps or reads the time except through a `Clock`."""

import ipaddress
import time
from collections.abc import Callable
from typing import Protocol

from drivers.errors import InputError

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """A monotonic clock in integer nanoseconds."""

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        ...

    def sleep_until(self, time_ns: int) -> None:
        """Return when `now_ns() >= time_ns`; immediately if that time has passed."""


class SystemClock:
    """The computer's monotonic clock.

    slowness: the clock advances by 1 s in this many seconds of the computer. Only tests give another one than
    1, for simulated devices and their drivers together: a loaded computer then keeps every time limit, and
    the limits on this clock stay the same. `require_full_speed` rejects it for other devices.
    """

    def __init__(self, slowness: int = 1) -> None:
        self.slowness = slowness

    def now_ns(self) -> int:
        return time.monotonic_ns() // self.slowness

    def sleep_until(self, time_ns: int) -> None:
        remaining_ns = time_ns - self.now_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns * self.slowness / NS_PER_S)


def slowness_of(clock: Clock) -> int:
    """Return the seconds of this computer per second of a clock; 1 for all but slowed system clocks."""
    return clock.slowness if isinstance(clock, SystemClock) else 1


def host_s(clock: Clock, duration_s: float) -> float:
    """Convert a duration on a clock, s, to the computer's time, s: for time limits of sockets and locks."""
    return duration_s * slowness_of(clock)


def require_full_speed(clock: Clock, device: str, host: str | None) -> None:
    """Raise `InputError` if a slowed clock is given for a device that may be real.

    A slowed clock lengthens every time limit, that of the arm's watchdog too. host: network address of the
    device, None without one. Simulated devices are at a loopback address, such as 127.0.0.1.
    """
    if slowness_of(clock) != 1 and not is_loopback(host or ""):
        raise InputError(
            f"{device}: a slowed clock lengthens all safety time limits, so it is for simulated devices at a "
            f"loopback address, and {host or 'a device without a network address'} may be real; use "
            "SystemClock()"
        )


def is_loopback(host: str) -> bool:
    """Whether an IP address is a loopback address of this computer; a host name is not accepted."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


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
