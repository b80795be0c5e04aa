"""The registers of the Robotiq 3-Finger gripper, its status, and its motion commands. Pure functions, no I/O.

Source: Robotiq 3-Finger Adaptive Robot Gripper instruction manual (2014 and 2018 editions),
section 4, "Robot output registers" and "Robot input registers". Both images are 15 bytes, sent
as 8 registers of two bytes, the first byte in the high half; the 16th byte is padding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from drivers.errors import DeviceError, GripperFaultError, InputError, OutOfLimitsError
from drivers.types import GripperSpec

REGISTERS = 8
"""Length of the command image and of the status image."""
FINGERS = ("A", "B", "C")
AXES = (*FINGERS, "S")
"""The three fingers and the scissor axis, in the order of their bytes (3, 6, 9, 12)."""

REFRESH_S = 0.006
"""Refresh time of the status, 200 Hz (manual, FC23 note); an earlier unchanged echo proves nothing."""
MIN_FORCE_N, MAX_FORCE_N = 15.0, 60.0
FORCE_PER_COUNT_N = 0.175
"""rFR: 0 is 15 N, not zero force; about 0.175 N per count, not linear (manual, FORCE register)."""
MIN_SPEED_M_S, MAX_SPEED_M_S = 0.022, 0.110
"""rSP: 0 is 22 mm/s, 255 is 110 mm/s (manual, SPEED register)."""


class GraspMode(IntEnum):
    """rMOD, gMOD: spread of fingers B and C, set by the scissor axis."""

    BASIC = 0
    PINCH = 1
    WIDE = 2
    SCISSOR = 3


class Stage(IntEnum):
    """gIMC: progress of the activation; only in READY does the gripper accept motions."""

    RESET = 0
    ACTIVATING = 1
    CHANGING_MODE = 2
    READY = 3


class MotionStatus(IntEnum):
    """gSTA: state of the fingers together. `MOVING` is valid only while gGTO is set."""

    MOVING = 0
    SOME_STOPPED_EARLY = 1
    ALL_STOPPED_EARLY = 2
    AT_REQUEST = 3


class ObjectStatus(IntEnum):
    """gDTA, gDTB, gDTC, gDTS: state of one axis."""

    MOVING = 0
    CONTACT_OPENING = 1
    CONTACT_CLOSING = 2
    AT_REQUEST = 3


ACTIVATION_NEEDED, MODE_CHANGE_PENDING, NOT_ACTIVATED = 0x05, 0x06, 0x07
FAULT_TEXTS = {
    ACTIVATION_NEEDED: "the action waits for the activation to end; activate, then move",
    MODE_CHANGE_PENDING: "the action waits for the mode change to end; move when it has",
    NOT_ACTIVATED: "the activation bit is not set; activate, then move",
    0x09: "the communication chip is not ready (may be booting); wait some seconds",
    0x0A: "something is in the way of the scissor axis; free the fingers within 20 s",
    0x0B: "automatic release in progress; wait until the fingers have opened",
    0x0D: "activation failed; free the fingers, then activate again",
    0x0E: "the scissor axis was blocked for 20 s; free the fingers, then activate again",
    0x0F: "automatic release done; activate again",
}
"""Codes of gFLT, 0 for none. 5 to 7: a command is rejected; 9 to 11: temporary; 13 to 15: activate again."""


@dataclass(frozen=True, slots=True)
class AxisRequest:
    """Request for one axis in counts, 0 to 255: rPR, rSP, rFR."""

    position: int = 0
    speed: int = 0
    force: int = 0


@dataclass(frozen=True, slots=True)
class Command:
    """The output image, from PC to gripper; the default value is a reset.

    `axes` are A, B, C and scissor. Unless `individual_fingers` is set, A's request is for all three fingers.
    """

    activate: bool = False
    mode: GraspMode = GraspMode.BASIC
    go_to: bool = False
    release: bool = False
    glove: bool = False
    individual_fingers: bool = False
    individual_scissor: bool = False
    axes: tuple[AxisRequest, ...] = (AxisRequest(),) * len(AXES)


@dataclass(frozen=True, slots=True)
class AxisState:
    """State of one axis: echo of its request (gPR), position (gPO), motor current (gCU), gDT.

    The current is in raw counts, because the manual and the ROS driver disagree on its unit.
    """

    requested: int
    position: int
    current: int
    status: ObjectStatus


@dataclass(frozen=True, slots=True)
class Status:
    """The input image, from gripper to PC; `fault` is the raw gFLT, `axes` are A, B, C and scissor."""

    activated: bool
    mode: GraspMode
    go_to: bool
    stage: Stage
    motion: MotionStatus
    fault: int
    axes: tuple[AxisState, ...]

    @property
    def ready(self) -> bool:
        return self.activated and self.stage is Stage.READY

    def axis(self, name: str) -> AxisState:
        return self.axes[AXES.index(name)]


def fault_code_text(code: int) -> str:
    """Return the meaning of a fault code and what to do about it, with its hexadecimal value."""
    if code not in FAULT_TEXTS:
        return f"fault 0x{code:02X}, which is not in the manual; reset and activate the gripper"
    return f"fault 0x{code:02X}, {FAULT_TEXTS[code]}"


def pack_command(command: Command) -> tuple[int, ...]:
    """Encode a command as 8 registers. Raises `OutOfLimitsError` for counts outside 0 to 255."""
    action = command.activate | command.mode << 1 | command.go_to << 3 | command.release << 4
    options = command.glove | command.individual_fingers << 2 | command.individual_scissor << 3
    axes = [value for axis in command.axes for value in (axis.position, axis.speed, axis.force)]
    values = [action, options, 0, *axes]
    if not all(isinstance(value, int) and 0 <= value <= 255 for value in values):
        raise OutOfLimitsError(f"gripper: a register byte is outside 0 to 255 in {values}")
    values += [0] * (2 * REGISTERS - len(values))
    return tuple(high << 8 | low for high, low in zip(values[::2], values[1::2], strict=True))


def unpack_status(registers: Sequence[int]) -> Status:
    """Decode the gripper's status image. Raises `DeviceError` unless it is 8 registers of 16 bits."""
    if len(registers) != REGISTERS or not all(0 <= register <= 0xFFFF for register in registers):
        raise DeviceError(
            f"gripper: {len(registers)} registers {list(registers)[:REGISTERS]} are not a register image; "
            f"expected {REGISTERS} of 16 bits: check the preset (rtu, tcp, tcp-2014)"
        )
    data = b"".join(register.to_bytes(2, "big") for register in registers)
    axes = [
        AxisState(data[at], data[at + 1], data[at + 2], ObjectStatus(data[1] >> 2 * number & 3))
        for number, at in enumerate((3, 6, 9, 12))
    ]
    return Status(
        activated=bool(data[0] & 1),
        mode=GraspMode(data[0] >> 1 & 3),
        go_to=bool(data[0] >> 3 & 1),
        stage=Stage(data[0] >> 4 & 3),
        motion=MotionStatus(data[0] >> 6),
        fault=data[2],
        axes=tuple(axes),
    )


def force_counts(force_n: float) -> int:
    """Return the nearest rFR for a force in N. Raises `OutOfLimitsError`, also below 15 N."""
    if not MIN_FORCE_N <= force_n <= MAX_FORCE_N:
        raise OutOfLimitsError(
            f"gripper: force {force_n} N is outside {MIN_FORCE_N:.0f} to {MAX_FORCE_N:.0f} N; "
            "for a lighter grip close in one-count steps and stop at the first tactile contact"
        )
    return min(round((force_n - MIN_FORCE_N) / FORCE_PER_COUNT_N), 255)


def speed_counts(speed_m_s: float) -> int:
    """Return the nearest rSP for a speed in m/s, 0.022 to 0.110. Raises `OutOfLimitsError`."""
    if not MIN_SPEED_M_S <= speed_m_s <= MAX_SPEED_M_S:
        raise OutOfLimitsError(
            f"gripper: speed {speed_m_s} m/s is outside {MIN_SPEED_M_S} to {MAX_SPEED_M_S} m/s"
        )
    return round(255 * (speed_m_s - MIN_SPEED_M_S) / (MAX_SPEED_M_S - MIN_SPEED_M_S))


ECHO_TIMEOUT_S = 0.8
"""Time in which the gripper must echo a command; it refreshes its registers every 5 ms."""


@dataclass(frozen=True, slots=True)
class GripperCommands:
    """The grasping fingers, their range, and the default speed and force of a motion.

    open_counts: position of the open fingers. A step of `spec` is one count, so an opening's position in
    counts is `open_counts` plus its step. Raises `InputError` and `OutOfLimitsError`.
    """

    fingers: Sequence[str]
    spec: GripperSpec
    open_counts: int
    speed_m_s: float
    force_n: float

    def __post_init__(self) -> None:
        fingers, closed_counts = self.fingers, self.open_counts + self.spec.steps
        if len(fingers) < 2 or len(set(fingers)) < len(fingers) or not set(fingers) <= set(FINGERS):
            raise InputError(f"gripper: fingers {list(fingers)}: name two or three of A, B and C")
        if not 0 <= self.open_counts < closed_counts <= 255:
            raise InputError(f"gripper: positions {self.open_counts} to {closed_counts}: not within 0 to 255")
        speed_counts(self.speed_m_s)
        force_counts(self.force_n)

    def grasping(self, status: Status) -> list[AxisState]:
        """Return the states of the grasping axes: the fingers, or in scissor mode the scissor axis."""
        names = ("S",) if status.mode is GraspMode.SCISSOR else self.fingers
        return [status.axis(name) for name in names]

    def position(self, status: Status) -> int:
        """Return the mean position of the grasping fingers, counts."""
        axes = self.grasping(status)
        return round(sum(axis.position for axis in axes) / len(axes))

    def opening(self, status: Status) -> float:
        """Return the opening at the mean position of the grasping fingers, m."""
        return self.spec.opening_at(self.position(status) - self.open_counts)

    def standing(self, status: Status) -> dict[str, int]:
        """Return the positions of the fingers that do not grasp."""
        return {name: status.axis(name).position for name in FINGERS if name not in self.fingers}

    def motion(
        self, opening_m: float, speed_m_s: float | None, force_n: float | None, mode: GraspMode,
        parked: Mapping[str, int],
    ) -> Command:  # fmt: skip
        """Return the command for a motion; `parked` fingers are commanded to stay at their counts.

        speed_m_s, force_n: the defaults if None. If all fingers move together, or the scissor axis grasps,
        A's request is for the whole hand (manual, POSITION REQUEST). Raises `OutOfLimitsError`.
        """
        self.spec.require_command(opening_m, speed_m_s, force_n)
        asked = AxisRequest(
            self.open_counts + self.spec.step_at(opening_m),
            speed_counts(self.speed_m_s if speed_m_s is None else speed_m_s),
            force_counts(self.force_n if force_n is None else force_n),
        )
        command = Command(activate=True, mode=mode, go_to=True)
        if mode is GraspMode.SCISSOR or len(self.fingers) == len(FINGERS):
            return replace(command, axes=(asked, *command.axes[1:]))
        fingers = [replace(asked, position=parked[n]) if n in parked else asked for n in FINGERS]
        return replace(command, individual_fingers=True, axes=(*fingers, AxisRequest()))


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
    unasked = status.fault in (ACTIVATION_NEEDED, NOT_ACTIVATED) and not status.ready and not was_ready
    if status.fault and not unasked:
        raise GripperFaultError(f"{name}: {fault_code_text(status.fault)}", status.fault)
    if was_ready and not status.ready and status.stage is not Stage.CHANGING_MODE:
        raise GripperFaultError(
            f"{name}: lost its activation (power cut or reset); make sure that the object is safe, "
            "then activate again",
            ACTIVATION_NEEDED,
        )


def require_ready(status: Status, name: str) -> None:
    """Raise `GripperFaultError` unless motions may be requested (5: not activated, 6: mode change)."""
    if status.stage is Stage.CHANGING_MODE:
        raise GripperFaultError(f"{name}: {fault_code_text(MODE_CHANGE_PENDING)}", MODE_CHANGE_PENDING)
    if not status.ready:
        raise GripperFaultError(
            f"{name}: not activated; request activation first (the fingers will sweep their range)",
            ACTIVATION_NEEDED,
        )
