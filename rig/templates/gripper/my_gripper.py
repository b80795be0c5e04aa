"""A template for a parallel gripper: replace the simulation of two fingers in this module."""

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import GripperFaultError, NotConnectedError
from drivers.interfaces import Gripper
from drivers.motion import PolledMotion
from drivers.types import GripperSpec, GripperState

SPEED_M_S = 0.07
"""Speed of a motion that is commanded without a speed."""
NOT_ACTIVATED = 5
"""Fault code; your manufacturer's codes may differ."""


class MyGripper(Gripper):
    """Called with keys of the bench file: these, `host`, `port` or `device` if you add them, and `options`.

    Openings between the fingertips are in m, speeds in m/s, forces in N. `spec` has the keys of
    [gripper.limits]: max_opening_m, stroke_m, resolution_m, speed_m_s, force_n. A command outside these
    ranges is refused before `move_to` is called. A reported opening that is clearly outside is an error.
    Raise `drivers.errors.DeviceError` for failures.
    """

    def __init__(self, spec: GripperSpec, clock: Clock) -> None:
        self._spec, self._clock = spec, clock
        self._connected = self._activated = False
        self._from_m = self._to_m = spec.open_m
        self._speed_m_s = SPEED_M_S
        self._began_ns = self._ends_ns = 0

    @property
    def spec(self) -> GripperSpec:
        """Range and resolution of the fingers, range of speed and force."""
        return self._spec

    def connect(self) -> None:
        """Connect to the gripper; nothing moves, and nothing is activated."""
        self._connected = True

    def disconnect(self) -> None:
        """Close the connection; the fingers stay as they are."""
        self._connected = False

    def activate(self) -> None:
        """Run the activation sequence; the rig has asked a person before."""
        self._activated = True

    def state(self) -> GripperState:
        """Return the newest state. Add `gripping` and `obstructed` if your gripper detects objects."""
        if not self._connected:
            raise NotConnectedError("gripper: used before connect; connect the bench first")
        now_ns = self._clock.now_ns()
        return GripperState(now_ns, self._activated, now_ns < self._ends_ns, self._opening_m())

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> PolledMotion:
        """Start moving the fingers and return immediately. Use default speed and force if they are None."""
        if not self.state().activated:
            raise GripperFaultError("gripper: not activated; the next trial asks for it", NOT_ACTIVATED)
        self._from_m, self._to_m = self._opening_m(), opening_m
        self._speed_m_s, self._began_ns = speed_m_s or SPEED_M_S, self._clock.now_ns()
        self._ends_ns = self._began_ns + to_ns(abs(self._to_m - self._from_m) / self._speed_m_s)
        return PolledMotion("gripper", self._clock, lambda: not self.state().moving, self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are."""
        self._from_m = self._to_m = self._opening_m()
        self._ends_ns = self._clock.now_ns()

    def _opening_m(self) -> float:
        travelled_m = self._speed_m_s * (self._clock.now_ns() - self._began_ns) / NS_PER_S
        return self._from_m + max(-travelled_m, min(travelled_m, self._to_m - self._from_m))
