"""A template for an arm: replace the simulated arm in this module."""

from collections.abc import Callable

import numpy as np

from drivers.clock import Clock, to_ns
from drivers.errors import NotConnectedError
from drivers.interfaces import Arm
from drivers.motion import PolledMotion
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector3

STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class MyArm(Arm):
    """Called with keys of the bench file: these, `host` if you add it, and each of `options`.

    The rig checks the file's workspace, speeds and keep-out boxes before `move_linear` is called. Your class
    must check joint limits: add `joint_limits_rad`. Raise `drivers.errors.DeviceError` for failures.
    """

    def __init__(
        self,
        limits: ArmLimits,
        flange_T_tcp: Pose,  # noqa: N803 - frame names keep their case
        payload_kg: float,
        payload_cog_m: Vector3,
        clock: Clock,
    ) -> None:
        self._limits, self._clock, self._connected = limits, clock, False
        self._from = self._to = Pose((0.45, 0.0, 0.30), (1.0, 0.0, 0.0, 0.0))
        self._began_ns = self._ends_ns = 0

    @property
    def limits(self) -> ArmLimits:
        """The limits that motions are checked against."""
        return self._limits

    def connect(self) -> None:
        """Connect to the arm; nothing moves. Set TCP and payload here, if your controller has them."""
        self._connected = True

    def disconnect(self) -> None:
        """Stop, and close the connection."""
        if self._connected:
            self.stop()
        self._connected = False

    def state(self) -> ArmState:
        """Return the newest state: pose of the tool in the base, joints in rad, wrench in N and N m.

        A wrench of None: no force sensor, and the bench file must state that. Never return zeros instead.
        """
        if not self._connected:
            raise NotConnectedError("arm: used before connect; connect the bench first")
        return ArmState(self._clock.now_ns(), self._pose(), STILL, None, ArmMode.RUNNING)

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> PolledMotion:  # noqa: N803
        """Start a straight motion and return immediately."""
        self._from, self._to = self.state().base_T_tcp, base_T_tcp
        way_m = float(np.linalg.norm(np.subtract(self._to.position_m, self._from.position_m)))
        self._began_ns = self._clock.now_ns()
        self._ends_ns = self._began_ns + to_ns(way_m / speed_m_s)
        return PolledMotion("arm", self._clock, lambda: self._clock.now_ns() >= self._ends_ns, self.stop)

    def stop(self) -> None:
        """Stop as fast as the arm can. Callable from any thread at any time; raises no error."""
        self._from = self._to = self._pose()
        self._ends_ns = self._clock.now_ns()

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop after `confirm(question)` returns; nothing moves. Here: never stopped."""

    def _pose(self) -> Pose:
        share = (self._clock.now_ns() - self._began_ns) / max(self._ends_ns - self._began_ns, 1)
        share = min(max(share, 0.0), 1.0)
        x, y, z = np.add(
            np.multiply(share, self._to.position_m), np.multiply(1 - share, self._from.position_m)
        )
        return Pose((float(x), float(y), float(z)), self._to.quaternion_xyzw)
