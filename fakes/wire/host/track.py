"""Where the simulated tool truly was, and what the fingers did: what safety is judged by."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Vector3

STILL_M_S = 0.001
"""Slower than this is standing still."""
KEPT = 50_000
"""Samples kept: three minutes of motion at 250 a second."""

TrackSample = tuple[int, float, float, float, float, bool]
"""ns of the world's time, tool x y z in m, counts of the fingers, whether the object is held."""


@dataclass(slots=True)
class Track:
    """Samples from where something changed; nothing is added while all stands still."""

    samples: deque[TrackSample] = field(default_factory=lambda: deque(maxlen=KEPT))
    moving: bool = False
    _last: TrackSample | None = None

    def see(self, time_ns: int, tool_m: Vector3, counts: float, held: bool) -> None:
        """Take how things are at a time; times increase."""
        new = (time_ns, *tool_m, counts, held)
        last, self._last = self._last, new
        if last is None:
            self.samples.append(new)
        elif time_ns > last[0]:
            way_m = float(np.linalg.norm(np.subtract(tool_m, last[1:4])))
            self.moving = way_m > STILL_M_S * (time_ns - last[0]) / NS_PER_S
            if new[1:] != last[1:]:
                if self.samples[-1] != last:
                    self.samples.append(last)  # until then nothing had changed
                self.samples.append(new)

    def since(self, time_ns: int) -> list[TrackSample]:
        """Return the samples from the last one before a time on, and how things are now."""
        kept = list(self.samples)
        first = next((i for i in range(len(kept) - 1, 0, -1) if kept[i][0] <= time_ns), 0)
        now = [self._last] if self._last is not None and kept[-1] != self._last else []
        return kept[first:] + now
