"""Waits for what a test wants to see."""

import time
from collections.abc import Callable


def until(met: Callable[[], bool], limit_s: float = 5.0) -> None:
    """Wait until something is so; fail where it is not in time."""
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.005)
