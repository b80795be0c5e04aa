"""The person at the bench: what a protocol asks of them and tells them."""

from typing import Protocol

from drivers.types import Vector3


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
