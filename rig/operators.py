"""Who is asked at the bench: a person at a terminal, or the simulated world."""

from collections.abc import Callable

from drivers.errors import OperatorStopError


class SimulatedOperator:
    """Agrees to everything; `place` lays an object, given by its id, into the simulated world."""

    def __init__(self, place: Callable[[str], object]) -> None:
        self._place = place

    def confirm(self, question: str) -> None:
        """Agree."""

    def look(self, question: str) -> None:
        """Agree."""

    def place(self, object_id: str, name: str) -> None:
        """Lay the object on its place."""
        self._place(object_id)

    def displaced(self) -> None:
        """Nothing to note: objects are laid down anew before each lift."""


class ConsoleOperator:
    """A person at a terminal; `ask` puts a question and returns whether they agree.

    agreed: they said yes beforehand, to everything that can be agreed to unseen.
    """

    def __init__(self, ask: Callable[[str], bool], agreed: bool = False) -> None:
        self._ask = ask
        self._agreed = agreed
        self._in_place: str | None = None

    def confirm(self, question: str) -> None:
        """Ask, and stop unless agreed."""
        if not self._agreed and not self._ask(question):
            raise OperatorStopError("stopped: the operator did not agree; nothing was moved")

    def look(self, question: str) -> None:
        """Ask in any case, and stop unless agreed."""
        if not self._ask(question):
            raise OperatorStopError("stopped: nobody at the bench agreed; nothing was moved")

    def place(self, object_id: str, name: str) -> None:
        """Ask for the object unless the last lift set it down in its place."""
        if self._in_place != object_id:
            self.confirm(f"Place object {object_id} ({name}) on its mark. Ready?")
        self._in_place = object_id

    def displaced(self) -> None:
        """Ask again before the next lift."""
        self._in_place = None
