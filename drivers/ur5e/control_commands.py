"""What the process that commands the arm can be asked for: ur-rtde's control interface, as methods.

`ControlClient` asks for them from the driver's process. Arguments and results travel as JSON, so
they are numbers, lists of numbers, and tuples, which arrive as lists.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from drivers.clock import SystemClock, to_ns
from drivers.ur5e.heartbeat import Heartbeat

KICK_S = 0.02
WATCHDOG_HZ = 12.5


class Operation(NamedTuple):
    """Number of the newest operation on the controller, and whether it goes on.

    halted: why it was stopped on its way, where `drivers.ur5e.heartbeat` stopped it.
    """

    number: int
    running: bool
    halted: str = ""


class Watchdog:
    """Keeps the controller's watchdog quiet from the moment it was started."""

    def __init__(self, control: Any) -> None:
        self._control = control
        self._clock = SystemClock()
        self._next_ns: int | None = None

    def start(self) -> bool:
        """Start it: from now on the program ends when nothing is written for 80 ms."""
        started = self._control.setWatchdog(WATCHDOG_HZ)
        self._next_ns = self._clock.now_ns() if started else None
        return started

    def kick(self) -> None:
        """Write something, if it is time."""
        if self._next_ns is not None and self._clock.now_ns() >= self._next_ns:
            self._next_ns = self._clock.now_ns() + to_ns(KICK_S)
            if self._control.isProgramRunning():
                self._control.kickWatchdog()


class ControlCommands:
    """The calls. `control` is ur-rtde's `RTDEControlInterface`, which has no type hints.

    Poses are x y z in m and a rotation vector in rad. False: the controller did not do it.
    """

    def __init__(self, control: Any, watchdog: Watchdog, heartbeat: Heartbeat) -> None:
        self._control = control
        self._watchdog = watchdog
        self._heartbeat = heartbeat
        self._guided = False

    def tcp(self) -> Sequence[float]:
        """The TCP that the controller has."""
        return self._control.getTCPOffset()

    def set_tcp(self, flange_tcp: Sequence[float]) -> tuple[bool, Sequence[float]]:
        """Set the TCP (x y z in m, rotation vector in rad); return also the one that is set now."""
        return self._control.setTcp(flange_tcp), self._control.getTCPOffset()

    def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> bool:
        """Set mass and centre of gravity of what hangs on the flange."""
        return self._control.setPayload(mass_kg, cog_m)

    def start_watchdog(self) -> bool:
        """Have the controller end the program, and the motion, when this process falls silent."""
        return self._watchdog.start()

    def joints_for(self, pose: Sequence[float], near_rad: Sequence[float]) -> list[float] | None:
        """Joint angles that reach a pose, those closest to `near_rad`; None when there are none.

        The safety limits are asked first: an inverse without a solution ends the program on the controller.
        """
        if not self._control.isPoseWithinSafetyLimits(pose):
            return None
        return self._control.getInverseKinematics(pose, near_rad)

    def move_linear(
        self, pose: Sequence[float], speed_m_s: float, acceleration_m_s2: float
    ) -> tuple[bool, int]:
        """Start a straight motion; return also the number of the operation before it."""
        before = self._control.getAsyncOperationProgressEx().operationId()
        self._heartbeat.begin(speed_m_s)
        return self._control.moveL(pose, speed_m_s, acceleration_m_s2, True), before

    def operation(self) -> Operation:
        """How far the newest motion is."""
        status = self._control.getAsyncOperationProgressEx()
        return Operation(status.operationId(), status.isAsyncOperationRunning(), self._heartbeat.halted)

    def stop_linear(self, deceleration_m_s2: float) -> None:
        """Begin to brake along the path; an arm that is led by hand is held first."""
        self._heartbeat.end()
        if self._guided:
            self.end_guiding()
        self._control.stopL(deceleration_m_s2, True)

    def begin_guiding(self) -> bool:
        """Let the arm be led by hand (URScript teach_mode)."""
        self._guided = True
        self._heartbeat.begin_guiding()
        return self._control.teachMode()

    def end_guiding(self) -> bool:
        """Back to position control (URScript end_teach_mode)."""
        self._heartbeat.end()
        self._guided = False
        return self._control.endTeachMode()

    def halted(self) -> str:
        """Why the newest motion, or the guiding by hand, was ended by `drivers.ur5e.heartbeat`; else ""."""
        return self._heartbeat.halted

    def zero_force_sensor(self) -> bool:
        """Take the present force and torque as zero."""
        return self._control.zeroFtSensor()

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for half a second."""
        return self._control.isSteady()

    def end_program(self) -> None:
        """End the program on the controller."""
        self._control.stopScript()
