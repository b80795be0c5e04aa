"""Who is asked at the bench: a person at a terminal, or the simulated world."""

from collections.abc import Callable

import numpy as np

from drivers.errors import InputError, OperatorStopError
from drivers.types import Vector3

_EYE_M = 1e-4
"""How well a person sees whether a tip sits in its hole, one sigma."""
_SEATED_M = 3e-4


class SimulatedOperator:
    """Agrees to everything; `place` lays an object, given by its id, into the simulated world.

    gap: from a tip in the hand to the hole on the table, m, base axes, as the world has it. prove:
    raises unless what is about to be driven is simulated; called wherever a person would be asked.
    """

    def __init__(
        self,
        place: Callable[[str], object],
        gap: Callable[[], Vector3] | None = None,
        seed: int = 0,
        prove: Callable[[], None] = lambda: None,
    ) -> None:
        self._place, self._gap, self._prove = place, gap, prove
        self._rng = np.random.default_rng((seed, 43))

    def confirm(self, question: str) -> None:
        """Agree."""
        self._prove()

    def look(self, question: str) -> None:
        """Agree."""
        self._prove()

    def place(self, object_id: str, name: str) -> None:
        """Lay the object on its place."""
        self._prove()
        self._place(object_id)

    def displaced(self) -> None:
        """Nothing to note: objects are laid down anew before each lift."""

    def nudge(self, question: str) -> Vector3 | None:
        """Look at tip and hole, with the eyes of a person, and say how far to go."""
        self._prove()
        if self._gap is None:
            raise InputError("this simulated bench has no tip and hole to look at")
        x, y, z = (float(v) for v in self._rng.normal(self._gap(), _EYE_M))
        return None if np.linalg.norm((x, y, z)) < _SEATED_M else (x, y, z)


class ConsoleOperator:
    """A person at a terminal; `ask` puts a question and returns whether they agree.

    agreed: they said yes beforehand, to everything that can be agreed to unseen. tell: puts a
    question and returns the line they type.
    """

    def __init__(
        self, ask: Callable[[str], bool], agreed: bool = False, tell: Callable[[str], str] | None = None
    ) -> None:
        self._ask, self._tell = ask, tell
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

    def nudge(self, question: str) -> Vector3 | None:
        """Have a small motion typed in mm; an empty line means that the tip sits in its hole."""
        if self._tell is None:
            raise OperatorStopError("stopped: somebody at a terminal has to guide the tip")
        while words := self._tell(f"{question} x y z in mm, empty when it sits, q to stop:").split():
            if words[0] in ("q", "quit"):
                raise OperatorStopError("stopped by the operator; the arm stands where it is")
            try:
                x, y, z = (float(word) / 1e3 for word in words)
            except ValueError:
                continue
            return x, y, z
        return None
