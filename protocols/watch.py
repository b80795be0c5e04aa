"""What a protocol needs from the people and programs that look on, as small interfaces."""

from enum import StrEnum
from typing import Protocol

from drivers.types import ArmState, Frame, GripperState, Vector3


class Phase(StrEnum):
    """Phases of a lift. A, B and C are the paper's (section IV-B); the others frame them."""

    REFERENCE = "reference"
    GRASP = "A"
    LIFT = "B"
    HOLD = "C"
    LOWER = "lower"


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
        """Whether the newest frame of a fingertip shows contact."""
        ...


class Operator(Protocol):
    """The person at the bench."""

    def confirm(self, question: str) -> None:
        """Ask before something moves. Raises `OperatorStopError` unless agreed."""
        ...

    def look(self, question: str) -> None:
        """Ask what only somebody who looks at the bench can know, so never agreed to beforehand.

        Raises `OperatorStopError` unless agreed.
        """
        ...

    def place(self, object_id: str, name: str) -> None:
        """See that an object lies in its place: has it laid there unless it was set down there.

        Raises `OperatorStopError`.
        """
        ...

    def nudge(self, question: str) -> Vector3 | None:
        """Ask how far the tool has to go, m, base axes; None when it is where it should be.

        Raises `OperatorStopError`.
        """
        ...

    def displaced(self) -> None:
        """Take note that the object is no longer in its place: it fell, or a fault left it anywhere."""
        ...
