"""What a protocol reports of a lift while it happens: a small interface, and the phases of a lift."""

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


class LiftObserver(Protocol):
    """Sees everything that happens, and can say whether a fingertip is touching."""

    def phase(self, phase: Phase, time_ns: int) -> None:
        """A phase begins."""
        ...

    def frame(self, frame: Frame) -> None:
        """A frame of a fingertip or of the external camera, in the order of arrival."""
        ...

    def arm(self, state: ArmState) -> None:
        """The arm's state, sampled just before each camera frame."""
        ...

    def gripper(self, state: GripperState) -> None:
        """The gripper's state, after each command and before each camera frame."""
        ...

    def touching(self, serial: str) -> bool:
        """Whether a fingertip touches: its last frames, not one alone, show contact."""
        ...
