"""When the simulated tool truly moved: what a fault has to be judged by, whatever a driver believes."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Vector3

STILL_M_S = 0.001
"""Slower than this is standing still."""
KEPT = 4096


@dataclass(slots=True)
class MotionLog:
    """Intervals of motion, [from, to] in ns of the world's time; the last one may be going on."""

    intervals: deque[list[int]] = field(default_factory=lambda: deque(maxlen=KEPT))
    moving: bool = False
    speed_m_s: float = 0.0
    _last: tuple[int, Vector3] | None = None

    def see(self, time_ns: int, tool_m: Vector3) -> None:
        """Take the tool's position at a time; times increase."""
        if self._last is not None and time_ns > self._last[0]:
            before_ns, before_m = self._last
            way = float(np.linalg.norm(np.subtract(tool_m, before_m)))
            self.speed_m_s = way / ((time_ns - before_ns) / NS_PER_S)
            self._extend(before_ns, time_ns)
        self._last = (time_ns, tool_m)

    def _extend(self, before_ns: int, time_ns: int) -> None:
        was, self.moving = self.moving, self.speed_m_s > STILL_M_S
        if self.moving and not was:
            self.intervals.append([before_ns, time_ns])
        elif self.moving:
            self.intervals[-1][1] = time_ns
