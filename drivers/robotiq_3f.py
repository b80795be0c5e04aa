"""The Robotiq 3-Finger gripper over Modbus TCP or RTU.

Two of its three fingers grasp, each told its own position (individual control, rICF); the third
is told to stay where it stands. Light grips are made of one-count steps of `move_to` with the
tactile image as the stop (`protocols/steps.py`): rFR = 0 already pushes with 15 N, and one
count is about 0.6 mm of opening if the stroke is 155 mm.

A finger that met an object at the force limit stays there until it is sent the other way, the
force is raised, or rGTO is cleared and set again (manual, OBJECT STATUS): sending it further
the same way ends at once, at the contact. The driver clears rGTO in `stop` only; doing so
often wears the gripper out, says the manual.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.clock import Clock, SystemClock, seconds
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError
from drivers.interfaces import Gripper
from drivers.robotiq_hand import Hand, echoes, require_ready, require_sound, under_way
from drivers.robotiq_line import GripperLine, Sample
from drivers.robotiq_modbus import Link, rtu_link, tcp_link
from drivers.robotiq_motion import GripperMotion
from drivers.robotiq_registers import Command, GraspMode, Stage, Status, pack_command
from drivers.types import GripperLimits, GripperState

__all__ = ["NOMINAL_LIMITS", "GraspMode", "GripperMotion", "Robotiq3F", "rtu_link", "tcp_link"]

NOMINAL_LIMITS = GripperLimits(6, 255, max_opening_m=0.155, opening_per_count_m=0.155 / 249)
"""Bare fingers; 6 is what an open finger reads (manual, status example after opening)."""
RESET_TIMEOUT_S = 2.0
ACTIVATION_TIMEOUT_S = 30.0
"""The fingers sweep their range for several seconds; a blocked sweep ends in fault 0x0D."""
MODE_CHANGE_TIMEOUT_S = 25.0
"""Interference ends in fault 0x0E after 20 s (manual, FAULT STATUS)."""
ECHO_TIMEOUT_S = 0.8
"""How soon the gripper has to show what it was told; it refreshes its registers every 5 ms."""
REFRESH_S = 0.006
"""Until one refresh after a command, an unchanged echo says nothing."""
WATCH_S = 0.01


@dataclass(frozen=True, slots=True)
class _Sent:
    """A motion command that has not shown in the status yet, and when it was acknowledged."""

    command: Command
    time_ns: int | None


class Robotiq3F(Gripper):
    """Drives a gripper over a `tcp_link` or `rtu_link`; usable from several threads.

    fingers: those that grasp, two or three of A, B, C. limits: counts and opening of this unit.
    speed_m_s, force_n: rSP and rFR of every motion (0.022 to 0.110 m/s, 15 to 60 N).
    Raises `InputError` and `OutOfLimitsError` for what the gripper cannot be told.
    """

    def __init__(
        self,
        link: Link,
        fingers: Sequence[str] = ("B", "C"),
        limits: GripperLimits = NOMINAL_LIMITS,
        clock: Clock | None = None,
        speed_m_s: float = 0.06,
        force_n: float = 15.0,
    ) -> None:
        self._link = link
        self._hand = Hand.of(fingers, limits, speed_m_s, force_n)
        self._clock = clock or SystemClock()
        self._line: GripperLine | None = None
        self._forget()

    def _forget(self) -> None:
        self._sent: _Sent | None = None
        self._parked: dict[str, int] | None = None
        self._was_ready = False
        self._activating = False

    @property
    def limits(self) -> GripperLimits:
        """Range of the fingers."""
        return self._hand.limits

    def connect(self) -> None:
        """Reach the gripper without moving it; anew if it was connected. Raises `DeviceError`."""
        self.disconnect()
        line = GripperLine(self._link, self._clock)
        line.open()
        self._line = line

    def disconnect(self) -> None:
        """Stop the fingers if they are on their way, and let go. Never raises."""
        line = self._line
        if line is None:
            return
        with suppress(DeviceError):  # where nobody hears us the fingers end where they were sent
            if under_way(line.sample().status):
                self.stop()
        self._line = None
        self._forget()
        line.close()

    def activate(self) -> None:
        """Reset the gripper and activate it: the fingers sweep their range, for several seconds.

        Ends in basic mode, without faults. Raises `GripperFaultError` (0x0D: something was in
        the way), `DeviceTimeoutError`, and `DeviceError` when `stop` ended it.
        """
        self._forget()
        self._activating = True
        try:
            self._send(Command())
            self._watch("the reset", lambda s: not s.activated and s.stage is Stage.RESET, RESET_TIMEOUT_S)
            self._send(Command(activate=True))
            self._watch("the activation bit", lambda s: s.activated, RESET_TIMEOUT_S)
            self._watch("activation", self._still_activating, ACTIVATION_TIMEOUT_S)
        finally:
            self._activating = False

    def set_mode(self, mode: GraspMode) -> None:
        """Turn the scissor axis to a grasping mode: fingers B and C move, so only on request.

        Raises `GripperFaultError` (0x0E: something was in the way) and `DeviceTimeoutError`.
        """
        require_ready(self._status(), self._link.name)
        self._send(Command(activate=True, mode=mode))
        self._watch(
            f"mode {mode.name}", lambda s: self._sound(s).ready and s.mode is mode, MODE_CHANGE_TIMEOUT_S
        )

    def state(self) -> GripperState:
        """Newest state, from the last 10 ms while the line is good.

        `position_counts` is the mean of the grasping fingers. `moving` is also true while the
        gripper has not shown yet that it took up a motion: until it echoes the request its
        status still tells of the motion before. Raises `GripperFaultError` for a fault code
        and for an activation that got lost (5), `DeviceTimeoutError` when the line or the echo
        stays silent.
        """
        sample = self._connected().sample()
        status = self._sound(sample.status)
        grasping = self._hand.grasping(status)
        return GripperState(
            time_ns=sample.time_ns,
            activated=status.ready or status.stage is Stage.CHANGING_MODE,
            moving=self._awaits_echo(sample) or under_way(status),
            position_counts=round(sum(axis.position for axis in grasping) / len(grasping)),
            current_counts=max(axis.current for axis in grasping),
            fault_code=status.fault,
        )

    def move_to(self, position_counts: int) -> GripperMotion:
        """Start moving the grasping fingers and return at once.

        Raises `GripperFaultError` (5: not activated, 6: mode change in progress) and
        `OutOfLimitsError` before anything is sent.
        """
        status = self._status()
        require_ready(status, self._link.name)
        parked = self._parked = self._parked or self._hand.standing(status)
        self._send(self._hand.motion(position_counts, status.mode, parked))
        return GripperMotion(self._clock, lambda: self.state().moving, self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are; ends an activation or a mode change by a reset.

        Returns when the gripper shows that it has stopped. Raises `DeviceError` when it cannot
        be reached: nobody has stopped it then.
        """
        status = self._connected().sample().status
        if status.stage in (Stage.ACTIVATING, Stage.CHANGING_MODE):
            self._was_ready = False
            self._send(Command())
        elif status.activated:
            self._send(Command(activate=True, mode=status.mode))
        self._watch("the stop", lambda s: not s.go_to and not under_way(s), ECHO_TIMEOUT_S)

    def identity(self) -> dict[str, str]:
        """What is known of the unit; its registers hold no serial number and no version."""
        return {"model": "Robotiq 3-Finger", "address": self._link.name}

    def round_trips_s(self) -> Sequence[float]:
        """Durations of the last answered requests, s; at most 1000."""
        return self._connected().round_trips_s()

    def counters(self) -> dict[str, int]:
        """Requests that failed since `connect`, retried ones included."""
        return {"failed_requests": self._connected().failures()}

    def _connected(self) -> GripperLine:
        line = self._line
        if line is None:
            raise NotConnectedError(f"{self._link.name}: used before connect; connect the bench first")
        return line

    def _status(self) -> Status:
        return self._sound(self._connected().sample().status)

    def _sound(self, status: Status) -> Status:
        require_sound(status, self._link.name, self._was_ready)
        self._was_ready = not self._activating and (self._was_ready or status.ready)
        return status

    def _send(self, command: Command) -> None:
        self._sent = _Sent(command, None) if command.go_to else None
        try:
            self._connected().send(pack_command(command))
        except DeviceError:
            self._sent = None
            raise
        if command.go_to:
            self._sent = _Sent(command, self._clock.now_ns())

    def _still_activating(self, status: Status) -> bool:
        if not status.activated:
            raise DeviceError(f"{self._link.name}: the activation was ended by a stop or a reset")
        return self._sound(status).ready

    def _awaits_echo(self, sample: Sample) -> bool:
        """Whether the last motion is still to show in the status; raises when it never does."""
        sent = self._sent
        if sent is None or sent.time_ns is None:
            return sent is not None
        if sample.time_ns >= sent.time_ns + seconds(REFRESH_S) and echoes(sample.status, sent.command):
            self._sent = None if self._sent is sent else self._sent
            return False
        if sample.time_ns > sent.time_ns + seconds(ECHO_TIMEOUT_S):
            raise DeviceTimeoutError(
                f"{self._link.name}: acknowledged a motion but did not take it up within {ECHO_TIMEOUT_S} s; "
                "check the preset (rtu, tcp, tcp-2014), then activate again"
            )
        return True

    def _watch(self, what: str, reached: Callable[[Status], bool], timeout_s: float) -> None:
        """Wait until `reached`, at the earliest one register refresh from now."""
        start = self._clock.now_ns()
        while True:
            sample = self._connected().sample()
            if sample.time_ns >= start + seconds(REFRESH_S) and reached(sample.status):
                return
            if self._clock.now_ns() > start + seconds(timeout_s):
                raise DeviceTimeoutError(
                    f"{self._link.name}: {what} not reached within {timeout_s} s; "
                    "check power and preset, then activate again"
                )
            self._clock.sleep_until(self._clock.now_ns() + seconds(WATCH_S))
