"""Wait for conditions in tests: with a limit that no host reaches, however loaded."""

import time
from collections.abc import Callable

LIMIT_S = 600.0
BURST_S = 0.2
"""Processor time over which the slowdown by other programs is measured: longer than a time slice."""


def until(met: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
    """Wait until a condition holds; fail at the time limit."""
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def slowdown() -> float:
    """Return how many times as long a computation takes now as on an idle host: at least 1."""
    began, spent = time.monotonic(), time.thread_time()
    while time.thread_time() - spent < BURST_S:
        pass
    return max(1.0, (time.monotonic() - began) / BURST_S)
