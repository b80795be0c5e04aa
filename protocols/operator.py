"""The person at the bench: questions and requests of a protocol."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

from drivers.types import Pose, Vector3

Guidance = AbstractContextManager[Callable[[], bool]]
"""Context in which the person guides the tool; the function returns whether they have confirmed its
arrival."""
DISPLACED = "the last object fell or may lie anywhere"
"""Why an object is not in its place after a fall or a fault."""


class Operator(Protocol):
    """The person at the bench."""

    def confirm(self, question: str) -> None:
        """Ask before something moves. Raises `OperatorStopError` unless the person agrees."""

    def look(self, question: str) -> None:
        """Ask a question that only a person looking at the bench can answer; it cannot be agreed beforehand.

        Raises `OperatorStopError` unless the person agrees.
        """

    def place(self, object_id: str, name: str) -> None:
        """Make sure that an object lies in its place; ask for it to be placed unless it was set down there.

        Raises `OperatorStopError`.
        """

    def hold(
        self,
        question: str,
        object_id: str,
        base_T_tcp: Pose,  # noqa: N803
        opening_m: float | None,
        turning: bool = False,
    ) -> None:
        """Ask a person to hold an object, instead of the arm, until the next question.

        base_T_tcp, opening_m: where a robot hand would hold it, for a simulated person. The opening is in m,
        None if no gel is touched. turning: whether the person turns it to and fro. Raises
        `OperatorStopError` unless the person holds it.
        """

    def nudge(self, question: str) -> Vector3 | None:
        """Ask for the tool's remaining displacement, m, base axes; None when it has arrived.

        Raises `OperatorStopError`.
        """
        ...

    def guide(self, question: str, where: Pose) -> "Guidance":
        """Ask a person to lead the compliant arm by hand to the place where an object is grasped.

        where: the estimated place, for a simulated person. Raises `OperatorStopError` if nobody is there.
        """
        ...

    def key(self, question: str, where: Pose, here: Pose) -> str:
        """Return the next key that a person presses to step the arm; "enter" when it has arrived.

        where, here: target pose and present pose of the tool, as far as known. Raises `OperatorStopError`.
        """
        ...

    def note_displaced(self, why: str = DISPLACED) -> None:
        """Note that the next object does not lie in its place until a person or a feeder has placed it.

        why: the reason, as the next question and a refusal give it.
        """
