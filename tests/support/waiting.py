"""Wait for conditions in tests: with a limit that no host reaches, however loaded."""

import time
from collections.abc import Callable

LIMIT_S = 120.0


def until(met: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
    """Wait until a condition holds; fail at the time limit."""
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.005)
