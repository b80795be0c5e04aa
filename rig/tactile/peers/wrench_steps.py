"""Convert the wrench at the wrist to the input of a recurrent network: equal time steps, relative to rest."""

import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.types import ArmState

PERIOD_S = 1.0 / 30.0
"""Duration of a step; states within a step are averaged."""
REST_S = 0.5
"""Time from the start of a grasp over which the wrench at rest, without the object, is averaged."""

Wrench = NDArray[np.float32]


class WrenchSteps:
    """Converts the arm's states from the grasp on to steps of (6,) float32, relative to the wrench at rest.

    A step is the force in N and the torque in N m, at the TCP in the base's axes. States that are not newer
    than the previous one, or have no wrench, are skipped.
    """

    def __init__(self) -> None:
        self._gathered: list[tuple[float, ...]] = []
        self._resting: list[tuple[float, ...]] = []
        self._began_ns: int | None = None
        self._newest_ns = self._due_ns = 0
        self._rest: NDArray[np.float64] | None = None

    def add(self, state: ArmState) -> Wrench | None:
        """Process a state; return the step that it completes, or None if it completes none."""
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
        # Half a period earlier than due, so that the state nearest to the step's end completes it.
        if state.time_ns < self._due_ns + to_ns(0.5 * PERIOD_S):
            return None
        self._due_ns = max(self._due_ns + to_ns(PERIOD_S), state.time_ns)
        step = np.mean(self._gathered, 0) - self._rest
        self._gathered.clear()
        return step.astype(np.float32)
