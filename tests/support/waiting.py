"""Wait for conditions in tests."""

import time
from collections.abc import Callable


def until(met: Callable[[], bool], limit_s: float = 5.0) -> None:
    """Wait until a condition holds; fail at the time limit."""
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.005)
