"""Latency: time from the capture of a frame until its angle is known and recorded."""

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.types import Frame
from protocols.observer import LiftEvents, Phase
from rig.sessions.timing import LatencyTimes


class LatencyProbe(LiftEvents):
    """Measures when each frame has been recorded and estimated. It must be the last observer.

    clock: the bench's clock, which also gives the capture times.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._phase = Phase.REFERENCE
        self._late_ns: dict[str, list[int]] = {}

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase."""
        self._phase = phase

    def frame(self, frame: Frame) -> None:
        """Measure the time since the capture of a frame."""
        if self._phase in (Phase.LIFT, Phase.HOLD):
            self._late_ns.setdefault(frame.serial, []).append(self._clock.now_ns() - frame.time_ns)

    def times(self) -> dict[str, LatencyTimes]:
        """Return the latency over phases B and C, by serial, ms: median, 95th, 99th percentile, maximum."""
        return {
            serial: LatencyTimes(*(np.percentile(late, (50, 95, 99, 100)) * 1e3 / NS_PER_S).tolist())
            for serial, late in self._late_ns.items()
        }
