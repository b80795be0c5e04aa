"""How long after its capture a frame's angle stands in the log."""

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.types import ArmState, Frame, GripperState
from protocols.observer import LiftObserver, Phase
from rig.sessions.timing import LatencyTimes


class LatencyProbe(LiftObserver):
    """Passes everything on, and takes the time when a frame was dealt with: recorded and estimated.

    clock: the bench's, which the frames' capture times are of.
    """

    def __init__(self, observer: LiftObserver, clock: Clock) -> None:
        self._observer = observer
        self._clock = clock
        self._phase = Phase.REFERENCE
        self._late_ns: dict[str, list[int]] = {}

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase."""
        self._observer.phase(phase, time_ns)
        self._phase = phase

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        self._observer.frame(frame)
        if self._phase in (Phase.LIFT, Phase.HOLD):
            self._late_ns.setdefault(frame.serial, []).append(self._clock.now_ns() - frame.time_ns)

    def arm(self, state: ArmState) -> None:
        """Take the arm's state."""
        self._observer.arm(state)

    def gripper(self, state: GripperState) -> None:
        """Take the gripper's state."""
        self._observer.gripper(state)

    def touching(self, serial: str) -> bool:
        """Whether a fingertip touches."""
        return self._observer.touching(serial)

    def times(self) -> dict[str, LatencyTimes]:
        """Return by serial how late angles came over phases B and C."""
        return {
            serial: LatencyTimes(*(np.percentile(late, (50, 95, 99, 100)) * 1e3 / NS_PER_S).tolist())
            for serial, late in self._late_ns.items()
        }
