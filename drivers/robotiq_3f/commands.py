"""Interpret a status of the Robotiq 3-Finger, and compose its motion commands. Pure functions, no I/O."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.clock import to_ns
from drivers.errors import DeviceTimeoutError, GripperFaultError, InputError
from drivers.robotiq_3f.registers import (
    AXES,
    FINGERS,
    REFRESH_S,
    AxisRequest,
    AxisState,
    Command,
    FaultCode,
    GraspMode,
    MotionStatus,
    Stage,
    Status,
    fault_code_text,
    force_counts,
    speed_counts,
)
from drivers.types import GripperSpec

ECHO_TIMEOUT_S = 0.8
"""Time in which the gripper must echo a command; it refreshes its registers every 5 ms."""
NOT_ACTIVE = (FaultCode.ACTIVATION_NEEDED, FaultCode.NOT_ACTIVATED)


@dataclass(frozen=True, slots=True)
class GripperCommands:
    """The grasping fingers, their range, and the default speed and force (rSP, rFR) of a motion.

    open_counts: position of the open fingers. A step of `spec` is one count, so an opening's position in
    counts is `open_counts` plus its step.
    """

    fingers: tuple[str, ...]
    spec: GripperSpec
    open_counts: int
    effort: AxisRequest

    @classmethod
    def of(
        cls, fingers: Sequence[str], spec: GripperSpec, open_counts: int, speed_m_s: float, force_n: float
    ) -> "GripperCommands":
        """Check the values and build. Raises `InputError` and `OutOfLimitsError`."""
        if len(fingers) < 2 or len(set(fingers)) < len(fingers) or not set(fingers) <= set(FINGERS):
            raise InputError(f"gripper: fingers {list(fingers)}: name two or three of A, B and C")
        closed_counts = open_counts + spec.steps
        if not 0 <= open_counts < closed_counts <= 255:
            raise InputError(f"gripper: positions {open_counts} to {closed_counts}: not within 0 to 255")
        effort = AxisRequest(0, speed_counts(speed_m_s), force_counts(force_n))
        return cls(tuple(fingers), spec, open_counts, effort)

    def counts_at(self, opening_m: float) -> int:
        return self.open_counts + self.spec.step_at(opening_m)

    def opening_at(self, counts: int) -> float:
        return self.spec.opening_at(counts - self.open_counts)

    def grasping(self, status: Status) -> list[AxisState]:
        """Return the states of the grasping axes: the fingers, or in scissor mode the scissor axis."""
        names = ("S",) if status.mode is GraspMode.SCISSOR else self.fingers
        return [status.axis(name) for name in names]

    def standing(self, status: Status) -> dict[str, int]:
        """Return the positions of the fingers that do not grasp."""
        return {name: status.axis(name).position for name in FINGERS if name not in self.fingers}

    def motion(
        self,
        opening_m: float,
        speed_m_s: float | None,
        force_n: float | None,
        mode: GraspMode,
        parked: Mapping[str, int],
    ) -> Command:
        """Return the command for a motion; `parked` fingers are commanded to stay at their counts.

        speed_m_s, force_n: those of `effort` if None. If all fingers move together, or the scissor axis
        grasps, A's request is for the whole hand (manual, POSITION REQUEST). Raises `OutOfLimitsError`.
        """
        self.spec.require_command(opening_m, speed_m_s, force_n)
        asked = AxisRequest(
            self.counts_at(opening_m),
            self.effort.speed if speed_m_s is None else speed_counts(speed_m_s),
            self.effort.force if force_n is None else force_counts(force_n),
        )
        command = Command(activate=True, mode=mode, go_to=True)
        if mode is GraspMode.SCISSOR or len(self.fingers) == len(FINGERS):
            return replace(command, axes=(asked, *command.axes[1:]))
        fingers = [replace(asked, position=parked[n]) if n in parked else asked for n in FINGERS]
        return replace(command, individual_fingers=True, axes=(*fingers, AxisRequest()))


@dataclass(frozen=True, slots=True)
class Sent:
    """A motion command, and the time (ns) of its acknowledgement; None before that."""

    command: Command
    time_ns: int | None

    def awaited(self, status: Status, time_ns: int, name: str) -> bool:
        """Whether a status requested at `time_ns` does not show the command yet.

        Raises `DeviceTimeoutError` if the gripper `name` never echoed the command.
        """
        if self.time_ns is None:
            return True
        if time_ns >= self.time_ns + to_ns(REFRESH_S) and echoes(status, self.command):
            return False
        if time_ns > self.time_ns + to_ns(ECHO_TIMEOUT_S):
            raise DeviceTimeoutError(
                f"{name}: acknowledged a motion but did not start it within {ECHO_TIMEOUT_S} s; "
                "check the preset (rtu, tcp, tcp-2014), then activate again"
            )
        return True


def under_way(status: Status) -> bool:
    """Whether the gripper moves: activation, mode change, or motion to a request."""
    if status.stage in (Stage.ACTIVATING, Stage.CHANGING_MODE):
        return True
    return status.go_to and status.motion is MotionStatus.MOVING


def echoes(status: Status, command: Command) -> bool:
    """Whether a status echoes a motion command: gGTO, and gPR of each commanded finger."""
    asked = FINGERS if command.individual_fingers else FINGERS[:1]
    return status.go_to and all(
        status.axis(name).requested == command.axes[AXES.index(name)].position for name in asked
    )


def require_sound(status: Status, name: str, was_ready: bool) -> None:
    """Raise `GripperFaultError` for a fault code, and for a lost activation (code 5).

    A gripper that was never activated answers 5 or 7 to a motion; that is its normal state, not a fault.
    name: of the gripper, for the message.
    """
    unasked = status.fault in NOT_ACTIVE and not status.ready and not was_ready
    if status.fault and not unasked:
        raise GripperFaultError(f"{name}: {fault_code_text(status.fault)}", status.fault)
    if was_ready and not status.ready and status.stage is not Stage.CHANGING_MODE:
        raise GripperFaultError(
            f"{name}: lost its activation (power cut or reset); make sure that the object is safe, "
            "then activate again",
            FaultCode.ACTIVATION_NEEDED,
        )


def require_ready(status: Status, name: str) -> None:
    """Raise `GripperFaultError` unless motions may be requested (5: not activated, 6: mode change)."""
    if status.stage is Stage.CHANGING_MODE:
        raise GripperFaultError(
            f"{name}: {fault_code_text(FaultCode.MODE_CHANGE_PENDING)}", FaultCode.MODE_CHANGE_PENDING
        )
    if not status.ready:
        raise GripperFaultError(
            f"{name}: not activated; request activation first (the fingers will sweep their range)",
            FaultCode.ACTIVATION_NEEDED,
        )
