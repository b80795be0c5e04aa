"""What the wrist and the gripper say to a slip that the fingertips see: they move the angle it is told at.

Each vote is worth `VOTE_DEG` at the most, so that no fingertip is overruled.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from drivers.types import ArmState, GripperState
from rig.sessions.manifest import Voters

VOTE_DEG = 0.1
LATELY_NS = 100_000_000
BEFORE_NS = 300_000_000
KEPT_NS = 800_000_000
LEAST_READINGS = 3
SIGMAS = 3.0


class WristVote:
    """For a slip while the torque that the wrist carries falls: pads that give way let go of it."""

    def __init__(self) -> None:
        self._read: deque[tuple[int, NDArray[np.float64]]] = deque()
        self._rest_nm = np.zeros(3)
        self._noise_nm: float | None = None

    def arm(self, state: ArmState) -> None:
        """Take a reading of the wrist; an arm without a force sensor has none, and this vote is 0."""
        if state.wrench is None:
            return
        self._read.append((state.time_ns, np.array(state.wrench[3:])))
        while state.time_ns - self._read[0][0] > KEPT_NS:
            self._read.popleft()

    def begin(self) -> None:
        """Learn what it reads at rest, and how far its readings scatter."""
        torques = np.array([torque for _, torque in self._read])
        if len(torques) >= 2 * LEAST_READINGS:
            self._rest_nm = torques.mean(axis=0)
            self._noise_nm = float(torques.std(axis=0).max())

    def moves_deg(self, now_ns: int) -> float:
        """Return by how much the angle is moved at which a slip is told: less where the torque falls."""
        late = self._carried(now_ns - LATELY_NS, now_ns)
        before = self._carried(now_ns - BEFORE_NS, now_ns - LATELY_NS)
        if self._noise_nm is None or min(len(late), len(before)) < LEAST_READINGS:
            return 0.0
        scatter = self._noise_nm * (1.0 / len(late) + 1.0 / len(before)) ** 0.5
        return -VOTE_DEG if float(np.mean(before) - np.mean(late)) > SIGMAS * scatter else 0.0

    def _carried(self, since_ns: int, until_ns: int) -> list[float]:
        """Torque since rest, N m, of the readings in a span."""
        return [
            float(np.linalg.norm(torque - self._rest_nm))
            for time_ns, torque in self._read
            if since_ns < time_ns <= until_ns
        ]


class GripperVote:
    """Against a slip while the fingers move, and shortly after: then contacts change by themselves."""

    def __init__(self) -> None:
        self._moved_ns: int | None = None
        self._counts: int | None = None

    def gripper(self, state: GripperState) -> None:
        """Take the gripper's state."""
        if state.moving or (self._counts is not None and state.position_counts != self._counts):
            self._moved_ns = state.time_ns
        self._counts = state.position_counts

    def moves_deg(self, now_ns: int) -> float:
        """Return by how much the angle is moved at which a slip is told: more where fingers have moved."""
        return VOTE_DEG if self._moved_ns is not None and now_ns - self._moved_ns <= BEFORE_NS else 0.0


class Votes:
    """The votes of those who may."""

    def __init__(self, voters: Voters) -> None:
        self._wrist = WristVote() if voters in (Voters.WRIST, Voters.BOTH) else None
        self._gripper = GripperVote() if voters in (Voters.GRIPPER, Voters.BOTH) else None

    def arm(self, state: ArmState) -> None:
        """Take the arm's state."""
        if self._wrist:
            self._wrist.arm(state)

    def gripper(self, state: GripperState) -> None:
        """Take the gripper's state."""
        if self._gripper:
            self._gripper.gripper(state)

    def begin(self) -> None:
        """Learn what is read at rest."""
        if self._wrist:
            self._wrist.begin()

    def cast(self, now_ns: int) -> dict[str, float]:
        """Return by voter by how much it moves the angle at which a slip is told, deg."""
        voters = {Voters.WRIST: self._wrist, Voters.GRIPPER: self._gripper}
        return {name.value: vote.moves_deg(now_ns) for name, vote in voters.items() if vote is not None}
