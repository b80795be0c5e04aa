"""The calls that the command process executes: ur-rtde's control interface, as methods.

`ControlClient` makes these calls from the driver's process. Arguments and results travel as JSON, so they
are numbers, lists of numbers, and tuples, which arrive as lists.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from drivers.clock import Clock, to_ns
from drivers.ur5e.heartbeat import Heartbeat

KICK_S = 0.02
"""Interval at which the controller's watchdog is kicked."""
WATCHDOG_HZ = 12.5
"""Lowest rate of kicks: after 80 ms without one the controller ends the program."""


class Operation(NamedTuple):
    """Number of the newest operation on the controller, and whether it is running.

    halted: reason if `drivers.ur5e.heartbeat` stopped it before its end.
    """

    number: int
    running: bool
    halted: str = ""


class Watchdog:
    """Kicks the controller's watchdog after it was started."""

    def __init__(self, control: Any, clock: Clock) -> None:
        self._control, self._clock = control, clock
        self._next_ns: int | None = None

    def start(self) -> bool:
        """Start the watchdog: from now on the program ends if nothing is written for 80 ms."""
        started = self._control.setWatchdog(WATCHDOG_HZ)
        self._next_ns = self._clock.now_ns() if started else None
        return started

    def kick(self) -> None:
        if self._next_ns is not None and self._clock.now_ns() >= self._next_ns:
            self._next_ns = self._clock.now_ns() + to_ns(KICK_S)
            if self._control.isProgramRunning():
                self._control.kickWatchdog()


class ControlCommands:
    """The calls. `control` is ur-rtde's `RTDEControlInterface`, which has no type hints.

    Poses are x y z in m and a rotation vector in rad. A result of False: the controller rejected the command.
    """

    def __init__(self, control: Any, watchdog: Watchdog, heartbeat: Heartbeat) -> None:
        self._control = control
        self._watchdog = watchdog
        self._heartbeat = heartbeat
        self._guided = False

    def tcp(self) -> Sequence[float]:
        return self._control.getTCPOffset()

    def set_tcp(self, flange_tcp: Sequence[float]) -> tuple[bool, Sequence[float]]:
        """Set the TCP (x y z in m, rotation vector in rad); also return the TCP that is set afterwards."""
        return self._control.setTcp(flange_tcp), self._control.getTCPOffset()

    def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> bool:
        return self._control.setPayload(mass_kg, cog_m)

    def start_watchdog(self) -> bool:
        """Make the controller end the program, and so the motion, if this process stops kicking it."""
        return self._watchdog.start()

    def joints_for(self, pose: Sequence[float], near_rad: Sequence[float]) -> list[float] | None:
        """Return joint angles that reach a pose, those closest to `near_rad`; None if there are none.

        The safety limits are checked first, because an inverse without a solution ends the program on the
        controller.
        """
        if not self._control.isPoseWithinSafetyLimits(pose):
            return None
        return self._control.getInverseKinematics(pose, near_rad)

    def move_linear(
        self, pose: Sequence[float], speed_m_s: float, acceleration_m_s2: float
    ) -> tuple[bool, int]:
        """Start a straight motion; also return the number of the operation before it."""
        before = self._control.getAsyncOperationProgressEx().operationId()
        self._heartbeat.begin(speed_m_s)
        return self._control.moveL(pose, speed_m_s, acceleration_m_s2, True), before

    def operation(self) -> Operation:
        status = self._control.getAsyncOperationProgressEx()
        return Operation(status.operationId(), status.isAsyncOperationRunning(), self._heartbeat.halted)

    def stop_linear(self, deceleration_m_s2: float) -> None:
        """Start braking along the path; if the arm is led by hand, guiding is ended first."""
        self._heartbeat.end()
        if self._guided:
            self.end_guiding()
        self._control.stopL(deceleration_m_s2, True)

    def begin_guiding(self) -> bool:
        """Let a person lead the arm by hand (URScript teach_mode)."""
        self._guided = True
        self._heartbeat.begin_guiding()
        return self._control.teachMode()

    def end_guiding(self) -> bool:
        """Return to position control (URScript end_teach_mode)."""
        self._heartbeat.end()
        self._guided = False
        return self._control.endTeachMode()

    def halted(self) -> str:
        """Return why `drivers.ur5e.heartbeat` ended the newest motion or guiding; empty if it did not."""
        return self._heartbeat.halted

    def zero_force_sensor(self) -> bool:
        return self._control.zeroFtSensor()

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for half a second."""
        return self._control.isSteady()

    def end_program(self) -> None:
        self._control.stopScript()
