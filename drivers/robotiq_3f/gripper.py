"""The Robotiq 3-Finger gripper over Modbus TCP or RTU.

Two of its three fingers grasp. Each is commanded to its own position (individual control, rICF); the third is
commanded to stay at its present position. Openings in m are converted to position counts only in this package
(`registers.py`). A light grip closes in steps of one count until the tactile images show contact
(`protocols/steps.py`), because rFR = 0 already pushes with 15 N; one count is about 0.6 mm of opening for a
stroke of 155 mm.

A finger that met an object at the force limit stays there until it is commanded in the other direction, the
force is raised, or rGTO is cleared and set again (manual, OBJECT STATUS). A further motion in the same
direction ends immediately, at the contact. The driver clears rGTO only in `stop`, and to close fingers that
opened without a command (`KeptGrip`), because the manual warns that doing so often wears the gripper out.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from drivers.clock import Clock, SystemClock, require_full_speed, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError
from drivers.interfaces import Gripper
from drivers.motion import Motion
from drivers.robotiq_3f.modbus import GripperLine, Link, StatusSample, rtu_link, tcp_link
from drivers.robotiq_3f.registers import (
    ECHO_TIMEOUT_S,
    MAX_FORCE_N,
    MAX_SPEED_M_S,
    MIN_FORCE_N,
    MIN_SPEED_M_S,
    REFRESH_S,
    Command,
    GripperCommands,
    ObjectStatus,
    Stage,
    Status,
    echoes,
    pack_command,
    require_ready,
    require_sound,
    under_way,
)
from drivers.types import GripperSpec, GripperState

__all__ = ["NOMINAL_SPEC", "OPEN_COUNTS", "Robotiq3F", "rtu_link", "tcp_link"]

OPEN_COUNTS = 6
"""Position reading of an open finger (manual, status example after opening)."""
NOMINAL_SPEC = GripperSpec(
    max_opening_m=0.155,
    stroke_m=0.155,
    resolution_m=0.155 / 249,
    speed_m_s=(MIN_SPEED_M_S, MAX_SPEED_M_S),
    force_n=(MIN_FORCE_N, MAX_FORCE_N),
)
"""Fingers without fingertip mounts: 155 mm over the 249 counts from 6 to 255."""
ACTIVATION = "activation"
RESET_TIMEOUT_S = 2.0
"""Time limit for the gripper to confirm a reset or the activation bit."""
ACTIVATION_TIMEOUT_S = 30.0
"""The fingers sweep their range for several seconds; a blocked sweep ends in fault 0x0D, interference in
fault 0x0E after 20 s (manual, FAULT STATUS)."""


class KeptGrip:
    """The reaction to fingers that open without a command: the command of the grip again.

    It sees each status that is read. A gripper may ignore a request that its registers already contain, so
    rGTO is cleared, which stops the fingers, and set again as soon as the status shows that. While they
    close, only a larger opening starts this again. Any other status ends the reaction for good: a fault, a
    lost activation, or a request or a stop from another program, which may be that of a person.

    command: the motion that made the grip. opening_at: the opening of a status, m. most_m: the largest
    opening of the grip. note: called with each larger opening, before the reaction to it.
    """

    def __init__(
        self, command: Command, opening_at: Callable[[Status], float], most_m: float,
        note: Callable[[float], None],
    ) -> None:  # fmt: skip
        self._command, self._released = command, replace(command, go_to=False)
        self._opening_at, self._most_m, self._note = opening_at, most_m, note
        self._limit_m = most_m
        self._sent = command
        self._recloses = self._ended = False

    def react(self, status: Status) -> tuple[int, ...] | None:
        """Return the command image to write now, None for none."""
        kept = echoes(status, self._command)
        released = self._recloses and not status.go_to  # also for a while after rGTO was set again
        self._ended = self._ended or bool(status.fault) or not (status.ready and (kept or released))
        if self._ended:
            return None
        opening_m = self._opening_at(status)
        if released:
            self._limit_m = max(self._limit_m, opening_m)
            return self._send(self._command) if self._sent is self._released else None
        if self._sent is self._command:
            self._recloses = False
        if opening_m <= self._most_m:
            self._limit_m = self._most_m
        elif opening_m > self._limit_m:
            self._note(opening_m)
            self._limit_m, self._recloses = opening_m, True
            return self._send(self._released)
        return None

    def _send(self, command: Command) -> tuple[int, ...]:
        self._sent = command
        return pack_command(command)


class Robotiq3F(Gripper):
    """Drives a gripper over a `tcp_link` or `rtu_link`; usable from several threads.

    fingers: the grasping fingers, two or three of A, B, C. spec: openings of this unit; one step is one
    count. open_counts: position of the open fingers. speed_m_s, force_n: defaults for motions without a speed
    or force (0.022 to 0.110 m/s, 15 to 60 N); None: the middle of the range. Raises `InputError` and
    `OutOfLimitsError` for values that cannot be commanded.
    """

    def __init__(
        self,
        link: Link,
        fingers: Sequence[str] = ("B", "C"),
        spec: GripperSpec = NOMINAL_SPEC,
        clock: Clock | None = None,
        speed_m_s: float | None = None,
        force_n: float = 15.0,
        open_counts: int = OPEN_COUNTS,
    ) -> None:
        self._link = link
        usual_m_s = sum(spec.speed_m_s) / 2 if speed_m_s is None else speed_m_s
        self.spec = spec
        self._commands = GripperCommands(tuple(fingers), spec, open_counts, usual_m_s, force_n)
        self._clock = clock or SystemClock()
        require_full_speed(self._clock, link.name, link.host)
        self._line: GripperLine | None = None
        self._lock = threading.Lock()
        self._sequence = ""
        """The activation or mode change in progress, if any."""
        self._stopped = False
        self._forget()

    def _forget(self) -> None:
        self._sent: tuple[Command, int | None] | None = None
        """The last motion command, and the time (ns) of its acknowledgement; None before that."""
        self._grip: Command | None = None
        """The last motion command, if no other command was sent since."""
        self._reclosed_from_m: float | None = None
        self._parked: dict[str, int] | None = None
        self._was_ready = False

    def connect(self) -> None:
        """Connect to the gripper without moving it; reconnect if it was connected. Raises `DeviceError`."""
        self.disconnect()
        line = GripperLine(self._link, self._clock)
        line.open()
        self._line = line

    def disconnect(self) -> None:
        """Stop the fingers if they are moving, and close the connection. Never raises."""
        line = self._line
        if line is None:
            return
        with suppress(DeviceError):  # if the gripper cannot be reached, the fingers end where they were sent
            # the status may not show yet a motion that was just sent
            if self._sent is not None or under_way(line.sample().status):
                self.stop()
        self._line = None
        self._forget()
        line.close()

    def activate(self) -> None:
        """Reset the gripper and activate it: the fingers sweep their range, for several seconds.

        Ends in basic mode, without faults. Raises `GripperFaultError` (0x0D: the sweep was blocked),
        `DeviceTimeoutError`, and `DeviceError` if `stop` ended it.
        """

        def is_activated(status: Status) -> bool:
            if not status.activated:
                raise DeviceError(
                    f"{self._link.name}: the activation was ended by a reset from another client"
                )
            return self._sound(status).ready

        # named, so that `stop` resets it whatever the status shows
        self._stopped, self._sequence = False, ACTIVATION
        try:
            self._forget()
            self._send(Command())
            self._watch("the reset", lambda s: not s.activated and s.stage is Stage.RESET, RESET_TIMEOUT_S)
            self._send(Command(activate=True))
            self._watch("the activation bit", lambda s: s.activated, RESET_TIMEOUT_S)
            self._watch("activation", is_activated, ACTIVATION_TIMEOUT_S)
        finally:
            self._sequence = ""

    def state(self) -> GripperState:
        """Return the newest state, at most 10 ms old while the connection is good.

        `opening_m` is the opening at the mean position of the grasping fingers. `raw` has this mean in
        counts (`position_counts`) and the larger motor current register (`current_counts`), whose unit is
        unknown: the manual and the ROS driver disagree. `mode` is basic, pinch, wide or scissor. `moving` is
        also true until the gripper echoes the request of a new motion, because its status then still
        describes the previous motion. Raises `GripperFaultError` for a fault code and for a lost activation
        (5), `DeviceTimeoutError` if neither a status nor the echo arrives.
        """
        sample = self._require_line().sample()
        status = self._sound(sample.status)
        grasping = self._commands.grasping(status)
        counts = self._commands.position(status)
        return GripperState(
            time_ns=sample.time_ns,
            activated=status.ready or status.stage is Stage.CHANGING_MODE,
            moving=self._awaits_echo(sample) or under_way(status),
            opening_m=self._commands.opening(status),
            fault_code=status.fault,
            gripping=any(axis.status is ObjectStatus.CONTACT_CLOSING for axis in grasping),
            obstructed=any(axis.status is ObjectStatus.CONTACT_OPENING for axis in grasping),
            raw={"position_counts": counts, "current_counts": max(axis.current for axis in grasping)},
            mode=status.mode.name.lower(),
            reclosed_from_m=self._reclosed_from_m,
        )

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the grasping fingers to the counts nearest to an opening, and return immediately.

        Raises `GripperFaultError` (5: not activated, 6: mode change in progress) and
        `OutOfLimitsError` before anything is sent.
        """
        status = self._sound(self._require_line().sample().status)
        require_ready(status, self._link.name)
        parked = self._parked = self._parked or self._commands.standing(status)
        self._send(self._commands.motion(opening_m, speed_m_s, force_n, status.mode, parked))
        return Motion("gripper", self._clock, lambda: not self.state().moving, self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are; an activation or a mode change is ended by a reset.

        Returns when the gripper reports that it has stopped. Raises `DeviceError` if it cannot be reached; it
        is then not stopped.
        """
        with self._lock:  # from here on the sequence in progress sends nothing more
            self._stopped = True
        status = self._require_line().sample().status
        if self._sequence or status.stage in (Stage.ACTIVATING, Stage.CHANGING_MODE):
            self._was_ready = False
            self._write(Command())
        elif status.activated:
            self._write(Command(activate=True, mode=status.mode))
        self._require_line().watch("the stop", lambda s: not s.go_to and not under_way(s), ECHO_TIMEOUT_S)

    def keep_grip(self, most_m: float) -> None:
        """Keep the grip until the next command, see `Gripper` and `KeptGrip`.

        Raises `GripperFaultError` for a fault and for a lost activation.
        """
        line = self._require_line()
        require_ready(self._sound(line.sample().status), self._link.name)
        if (command := self._grip) is not None:
            line.react = KeptGrip(command, self._commands.opening, most_m, self._note_reclosing).react

    def _note_reclosing(self, opening_m: float) -> None:
        before_m = self._reclosed_from_m
        self._reclosed_from_m = opening_m if before_m is None else max(before_m, opening_m)

    def identity(self) -> dict[str, str]:
        """Return the model and the address; the gripper reports neither a serial number nor a version."""
        return {"model": "Robotiq 3-Finger", "address": self._link.name}

    def round_trips_s(self) -> Sequence[float]:
        """Return the durations of the last answered requests, s; at most 1000."""
        return tuple(self._require_line().requests.round_trips_s)

    def counters(self) -> dict[str, int]:
        """Return the number of failed requests since `connect`, retried ones included."""
        return {"failed_requests": self._require_line().requests.failures}

    def _require_line(self) -> GripperLine:
        line = self._line
        if line is None:
            raise NotConnectedError(f"{self._link.name}: used before connect; connect the bench first")
        return line

    def _sound(self, status: Status) -> Status:
        require_sound(status, self._link.name, self._was_ready)
        self._was_ready = self._sequence != ACTIVATION and (self._was_ready or status.ready)
        return status

    def _send(self, command: Command) -> None:
        with self._lock:
            self._require_unstopped()
            self._write(command)

    def _require_unstopped(self) -> None:
        if self._sequence and self._stopped:
            raise DeviceError(f"{self._link.name}: the {self._sequence} was ended by a stop")

    def _write(self, command: Command) -> None:
        self._sent = (command, None) if command.go_to else None
        self._grip = command if command.go_to else None
        try:
            self._require_line().send(pack_command(command))
        except DeviceError:
            self._sent = None
            raise
        if command.go_to:
            self._sent = command, self._clock.now_ns()

    def _awaits_echo(self, sample: StatusSample) -> bool:
        """Whether the status does not show the last motion yet. Raises if it never does."""
        sent = self._sent
        if sent is None:
            return False
        command, sent_ns = sent
        if sent_ns is None:
            return True
        if sample.time_ns >= sent_ns + to_ns(REFRESH_S) and echoes(sample.status, command):
            self._sent = None if self._sent is sent else self._sent
            return False
        if sample.time_ns > sent_ns + to_ns(ECHO_TIMEOUT_S):
            raise DeviceTimeoutError(
                f"{self._link.name}: acknowledged a motion but did not start it within {ECHO_TIMEOUT_S} s; "
                "check the preset (rtu, tcp, tcp-2014), then activate again"
            )
        return True

    def _watch(self, what: str, reached: Callable[[Status], bool], timeout_s: float) -> None:
        """Wait for a step of a sequence. Raises if `stop` has ended the sequence."""

        def reached_unstopped(status: Status) -> bool:
            self._require_unstopped()
            return reached(status)

        self._require_line().watch(what, reached_unstopped, timeout_s)
