"""Interface through which a protocol reports a lift while it happens: phases, frames, states, reactions."""

from enum import StrEnum
from typing import Protocol

from drivers.types import ArmState, Frame, GripperState


class Phase(StrEnum):
    """Phases of a lift. A, B and C are the paper's (section IV-B); the others frame them."""

    REFERENCE = "reference"
    GRASP = "A"
    LIFT = "B"
    HOLD = "C"
    LOWER = "lower"


REQUIRED = (Phase.REFERENCE, Phase.GRASP, Phase.LIFT, Phase.HOLD, Phase.LOWER)
"""Phases that every whole lift has, in their order. Recordings of other versions may have further ones."""


class ReactionStep(StrEnum):
    """Steps of a reaction to slip: commands, and when the parts that they move stood still.

    stop: the arm is commanded to stop. stands: the arm stands still. close, closed: the same of the fingers,
    with their position. rest: the object has stopped turning, the lift goes on. ends: the lift ends
    at its present height.
    """

    STOP = "stop"
    STANDS = "stands"
    CLOSE = "close"
    CLOSED = "closed"
    REST = "rest"
    ENDS = "ends"


class LiftEvents(Protocol):
    """Receives what happens in a lift, in the order of arrival. Unless overridden, events are ignored."""

    def phase(self, phase: Phase, time_ns: int) -> None:
        """A phase begins."""

    def frame(self, frame: Frame) -> None:
        """A frame of a fingertip or of the external camera, with its JPEG."""

    def arm(self, state: ArmState) -> None:
        """The arm's state, sampled just before each camera frame."""

    def gripper(self, state: GripperState) -> None:
        """The gripper's state, after each command and before each camera frame."""

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        """A step of a reaction to slip. position: commanded, in the gripper's steps from open."""


class LiftObserver(LiftEvents, Protocol):
    """Receives what happens in a lift, and knows whether a fingertip is in contact."""

    def touching(self, serial: str) -> bool:
        """Whether a fingertip is in contact, judged by its last frames, not by one alone."""
        ...
