"""A gripper of your own: replace what pretends. As it is, two fingers in this program that nobody sees."""

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import GripperFaultError, NotConnectedError
from drivers.interfaces import Gripper
from drivers.motion import PolledMotion
from drivers.types import GripperLimits, GripperState

COUNTS_PER_S = 110.0
NOT_ACTIVATED = 5
"""Fault codes are your maker's."""


class MyGripper(Gripper):
    """Called with keys of the bench file: these, `host`, `port` or `device` if you add them, and `options`.

    Positions are in counts, `min_counts` open to `max_counts` closed, within 0 to 255: scale yours. A
    position that is clearly outside this range is an error. Raise `drivers.errors.DeviceError` for failures.
    """

    def __init__(self, limits: GripperLimits, clock: Clock) -> None:
        self._limits, self._clock = limits, clock
        self._connected = self._activated = False
        self._from = self._to = float(limits.min_counts)
        self._began_ns = self._ends_ns = 0

    @property
    def limits(self) -> GripperLimits:
        """Range of the fingers."""
        return self._limits

    def connect(self) -> None:
        """Reach the gripper; nothing moves, and nothing is activated."""
        self._connected = True

    def disconnect(self) -> None:
        """Let go; the fingers stay as they are."""
        self._connected = False

    def activate(self) -> None:
        """Run the activation sequence; the rig has asked somebody before."""
        self._activated = True

    def state(self) -> GripperState:
        """Newest state: time, activated, moving, counts, current, fault code."""
        if not self._connected:
            raise NotConnectedError("gripper: used before connect; connect the bench first")
        now_ns = self._clock.now_ns()
        return GripperState(now_ns, self._activated, now_ns < self._ends_ns, round(self._counts()), 0, 0)

    def move_to(self, position_counts: int) -> PolledMotion:
        """Start moving the fingers and return at once."""
        if not self.state().activated:
            raise GripperFaultError("gripper: not activated; the next trial asks for it", NOT_ACTIVATED)
        self._from, self._to, self._began_ns = self._counts(), float(position_counts), self._clock.now_ns()
        self._ends_ns = self._began_ns + to_ns(abs(self._to - self._from) / COUNTS_PER_S)
        return PolledMotion("gripper", self._clock, lambda: not self.state().moving, self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are."""
        self._from = self._to = self._counts()
        self._ends_ns = self._clock.now_ns()

    def _counts(self) -> float:
        gone = COUNTS_PER_S * (self._clock.now_ns() - self._began_ns) / NS_PER_S
        return self._from + max(-gone, min(gone, self._to - self._from))
