"""The person at the bench: what a protocol asks of them and tells them."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

from drivers.types import Pose, Vector3

Guidance = AbstractContextManager[Callable[[], bool]]
"""While it lasts somebody is asked; called, it says whether they say that the tool is there."""


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

    def hold(self, question: str, object_id: str, base_T_tcp: Pose, opening_m: float | None) -> None:  # noqa: N803
        """Have an object held by a person, not by the arm, until the next question.

        base_T_tcp, opening_m: where a robot hand would hold it so, for a simulated person. The opening is in
        m, None if no gel is touched. Raises `OperatorStopError` unless the person holds it.
        """
        ...

    def nudge(self, question: str) -> Vector3 | None:
        """Ask how far the tool has to go, m, base axes; None when it is where it should be.

        Raises `OperatorStopError`.
        """
        ...

    def guide(self, question: str, where: Pose) -> "Guidance":
        """Have the arm led by hand to where something is grasped; the arm gives way meanwhile.

        where: it is thought to be; people see it. Raises `OperatorStopError` where nobody is there.
        """
        ...

    def key(self, question: str, where: Pose, here: Pose) -> str:
        """Return the next key that a person presses to step the arm; "enter" where it is there.

        where, here: the tool is to be, and is, as far as known. Raises `OperatorStopError`.
        """
        ...

    def displaced(self) -> None:
        """Take note that the object is no longer in its place: it fell, or a fault left it anywhere."""
        ...
