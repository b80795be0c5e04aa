"""Interface through which a protocol reports the events of a lift: phases, frames, states, reactions."""

from enum import StrEnum
from typing import Protocol

from drivers.types import ArmState, Frame, GripperState


class Phase(StrEnum):
    """Phases of every complete lift, in order. A, B and C are those of the paper (section IV-B)."""

    REFERENCE = "reference"
    GRASP = "A"
    LIFT = "B"
    HOLD = "C"
    LOWER = "lower"


class ReactionStep(StrEnum):
    """Steps of a reaction to slip: commands, and the times at which the commanded part stands still.

    stop: the arm is commanded to stop. stands: the arm stands still. close, closed: the same for the fingers,
    with their position. rest: the object has stopped rotating and the lift continues. ends: the lift ends at
    its present height.
    """

    STOP = "stop"
    STANDS = "stands"
    CLOSE = "close"
    CLOSED = "closed"
    REST = "rest"
    ENDS = "ends"


class LiftEvents(Protocol):
    """Receives the events of a lift in order of arrival. Events that are not overridden are ignored."""

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Receive the start of a phase."""

    def frame(self, frame: Frame) -> None:
        """Receive a frame of a fingertip or of the external camera, with its JPEG."""

    def arm(self, state: ArmState) -> None:
        """Receive the arm's state, sampled just before each camera frame."""

    def gripper(self, state: GripperState) -> None:
        """Receive the gripper's state, after each command and before each camera frame."""

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        """Receive a step of a reaction to slip. position: commanded, in the gripper's steps from open."""


class NoEvents(LiftEvents):
    """Ignores all events: takes the place of an observer that is not needed."""

    def close(self) -> None:
        """Do nothing, as there is nothing to release."""


NO_EVENTS = NoEvents()


class LiftObserver(LiftEvents, Protocol):
    """Receives the events of a lift, and reports whether a fingertip is in contact."""

    def touching(self, serial: str) -> bool:
        """Whether a fingertip is in contact, decided from several newest frames, not from a single one."""
        ...
