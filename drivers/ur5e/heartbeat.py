"""A motion goes on only as long as the program that began it looks at the arm.

A program that is stopped (SIGSTOP), hangs or swaps would otherwise leave a motion to run to its end: the
process that commands lives on and keeps the controller's watchdog quiet. Each look at the arm's state in
the loop that works is a beat; no thread beats beside it.
"""

from typing import Any

from drivers.clock import NS_PER_S, SystemClock, to_ns
from drivers.ur5e.shared_state import SharedState

MOST_WAY_M = 0.020
"""How far the arm may go on after the last beat."""
BRAKE_M_S2 = 10.0
REACTION_S = 0.010
"""From the decision to stop to the first slower cycle, and from a beat to its look (ours, rounded up)."""
LEAST_S, LONGEST_S = 0.03, 0.35
"""Less than this a computer cannot keep; more than this no motion goes on unwatched, however slow."""


def silence_limit_s(speed_m_s: float) -> float:
    """How long a motion may go on without a beat, so that the arm stands within `MOST_WAY_M`, s."""
    left_m = MOST_WAY_M - speed_m_s**2 / (2 * BRAKE_M_S2)
    return min(LONGEST_S, max(LEAST_S, left_m / speed_m_s - REACTION_S))


class Heartbeat:
    """Stops a motion of ur-rtde's `control` when nobody has looked at the arm for too long."""

    def __init__(self, control: Any, state: SharedState) -> None:
        self._control, self._state, self._clock = control, state, SystemClock()
        self._limit_ns: int | None = None
        self._began_ns = 0
        self.silence_s = 0.0
        """How long nobody had looked when the newest motion was stopped; 0 where it was not."""

    def begin(self, speed_m_s: float) -> None:
        """Watch a motion that begins now."""
        self._limit_ns, self.silence_s = to_ns(silence_limit_s(speed_m_s)), 0.0
        self._began_ns = self._clock.now_ns()

    def end(self) -> None:
        """The motion is over, or told to stop."""
        self._limit_ns = None

    def check(self) -> None:
        """Stop the motion where nobody looks any more."""
        if self._limit_ns is None:
            return
        silent_ns = self._clock.now_ns() - max(self._began_ns, self._state.looked_ns())
        if silent_ns <= self._limit_ns:
            return
        if self._control.getAsyncOperationProgressEx().isAsyncOperationRunning():
            self._control.stopL(BRAKE_M_S2, True)
            self.silence_s = silent_ns / NS_PER_S
        self.end()
