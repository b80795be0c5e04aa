"""Slow motion: simulated devices, their drivers and the rig on a clock that is slower than real time.

Benches over the wire protocols have time limits: the watchdog of the arm's controller ends its program after
80 ms without a command, a fingertip is lost after 0.25 s without a frame. A host on which other programs run
does not keep them. On the slower clock all limits, speeds and frame rates stay the same, and the host has
`SLOWNESS` times as long for each. So a test still fails if an arm stops too late. How slow the clock is
depends on how busy the host is when the tests start.
"""

import time
from functools import partial

import pytest

from drivers.clock import SystemClock, host_s
from rig.bench.fakes_process import started_fakes
from support.waiting import slowdown

LEAST, MOST = 6, 16
"""Bounds of the slowness: programs may start later; and at MOST a lift takes four minutes."""
PER_SLOWDOWN = 3.0
"""Slowness per slowdown of a computation: a lift over the wire protocols takes a core on an idle host."""
SLOWNESS = round(min(max(PER_SLOWDOWN * slowdown(), LEAST), MOST))
CLOCK = SystemClock(SLOWNESS)
IN_SLOW_MOTION = f"""
from functools import partial
import rig.bench.assembly, rig.bench.fakes_process as fakes
from drivers.clock import SystemClock
rig.bench.assembly.SystemClock = partial(SystemClock, {SLOWNESS})
fakes.started_fakes = partial(fakes.started_fakes, slowness={SLOWNESS})
"""
"""First lines of a program for `python -c` that runs benches in slow motion."""


def pause(duration_s: float) -> None:
    """Sleep for a time of the slow clock, s."""
    time.sleep(host_s(CLOCK, duration_s))


def slow_down(patch: pytest.MonkeyPatch, *modules: str) -> None:
    """Run benches of this process in slow motion. modules: those that import `started_fakes`."""
    patch.setattr("rig.bench.assembly.SystemClock", lambda: CLOCK)
    for module in ("rig.bench.fakes_process", *modules):
        patch.setattr(f"{module}.started_fakes", partial(started_fakes, slowness=SLOWNESS))
