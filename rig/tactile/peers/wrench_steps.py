"""The wrench at the wrist as a recurrent network takes it: in even steps, from what it was at rest."""

import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.types import ArmState

PERIOD_S = 1.0 / 30.0
"""Of a step; states that come faster are averaged."""
REST_S = 0.5
"""The first moments of a grasp, whose mean is what the wrist feels of everything but the object."""

Wrench = NDArray[np.float32]


class WrenchSteps:
    """Turns the arm's states, from the grasp on, into steps of (6,) float32: force in N, torque in N m.

    Base axes, at the TCP. States that are not newer than the previous one, or have no wrench, are skipped.
    """

    def __init__(self) -> None:
        self._gathered: list[tuple[float, ...]] = []
        self._resting: list[tuple[float, ...]] = []
        self._began_ns: int | None = None
        self._newest_ns = self._due_ns = 0
        self._rest: NDArray[np.float64] | None = None

    def add(self, state: ArmState) -> Wrench | None:
        """Take a state; return the step that it completes, None where none is due or the rest still lasts."""
        if state.wrench is None or (self._began_ns is not None and state.time_ns <= self._newest_ns):
            return None
        self._newest_ns = state.time_ns
        if self._began_ns is None:
            self._began_ns = state.time_ns
        if self._rest is None:
            self._resting.append(state.wrench)
            if state.time_ns - self._began_ns >= to_ns(REST_S):
                self._rest, self._due_ns = np.mean(self._resting, 0), state.time_ns
            return None
        self._gathered.append(state.wrench)
        # half a period early: the state nearest to the step's end completes it
        if state.time_ns < self._due_ns + to_ns(0.5 * PERIOD_S):
            return None
        self._due_ns = max(self._due_ns + to_ns(PERIOD_S), state.time_ns)
        step = np.mean(self._gathered, 0) - self._rest
        self._gathered.clear()
        return step.astype(np.float32)
