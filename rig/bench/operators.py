"""The operator at the bench: a person at a terminal, or a simulated one."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from drivers.errors import InputError, OperatorStopError
from drivers.types import Pose, Vector3
from protocols.operator import DISPLACED, Guidance
from protocols.teach import STEPS_DEG, STEPS_M

_log = logging.getLogger("rig.bench.operators")
_EYE_M = 1e-4
"""Accuracy with which a person sees whether a tip sits in its hole, one sigma."""
_SEATED_M = 3e-4
"""Distance below which the tip counts as seated."""
_LED_M = 1e-3
"""Accuracy with which a person leads an arm to a place, one sigma along each axis."""


class SimulatedOperator:
    """Agrees to everything; `place` puts an object, given its id, into the simulated world.

    gap: returns the displacement from a tip in the hand to the hole on the table, m, base axes. lead: starts
    to lead the arm to a pose, and returns a function that returns whether the arm has arrived. prove: raises
    unless the devices are simulated; called in place of each question to a person. hold: holds an object at a
    pose, pressed to an opening in m, or without contact if the opening is None; its last argument is whether
    the object is turned to and fro.
    """

    def __init__(
        self,
        place: Callable[[str], object],
        gap: Callable[[], Vector3],
        lead: Callable[[Pose], Callable[[], bool]],
        seed: int,
        prove: Callable[[], None] = lambda: None,
        hold: Callable[[str, Pose, float | None, bool], None] | None = None,
    ) -> None:
        self._place, self._gap, self._prove, self._lead, self._hold = place, gap, prove, lead, hold
        self._step_size = ""
        self._rng = np.random.default_rng((seed, 43))

    def confirm(self, question: str) -> None:
        self._prove()

    def look(self, question: str) -> None:
        self._prove()

    def place(self, object_id: str, name: str) -> None:
        self._prove()
        self._place(object_id)

    def hold(
        self,
        question: str,
        object_id: str,
        base_T_tcp: Pose,  # noqa: N803
        opening_m: float | None,
        turning: bool = False,
    ) -> None:
        self._prove()
        if self._hold is None:
            raise InputError("on this simulated bench no person can hold an object; use --bench fake")
        self._hold(object_id, base_T_tcp, opening_m, turning)

    def note_displaced(self, why: str = DISPLACED) -> None:
        """Do nothing: objects are placed again before each lift."""

    def nudge(self, question: str) -> Vector3 | None:
        """Return the displacement that a person would see between tip and hole."""
        self._prove()
        x, y, z = (float(v) for v in self._rng.normal(self._gap(), _EYE_M))
        return None if np.linalg.norm((x, y, z)) < _SEATED_M else (x, y, z)

    @contextmanager
    def guide(self, question: str, where: Pose) -> Iterator[Callable[[], bool]]:
        """Lead the arm there, with the accuracy of a person."""
        self._prove()
        x, y, z = (float(v) for v in self._rng.normal(0.0, _LED_M, 3))
        led = Pose.from_rotation(where.translated(x, y, z).position_m, where.rotation)
        arrived: list[Callable[[], bool]] = []

        def there() -> bool:
            if not arrived:  # the arm is compliant only from now on
                arrived.append(self._lead(led))
            return arrived[0]()

        yield there

    def key(self, question: str, where: Pose, here: Pose) -> str:
        self._prove()
        if question:
            self._step_size = ""
        for size in ("3", "2", "1"):
            if pressed := _nearer(where, here, size):
                changed, self._step_size = self._step_size != size, size
                return size if changed else pressed
        return "enter"


class ConsoleOperator:
    """A person at a terminal; `ask` prints a question and returns whether they agree.

    agreed: whether the person has agreed in advance to all questions that need no check of the bench, and has
    placed the first object. tell: prints a question and returns the typed line. wait: prints a question and
    returns a function that is polled for the answer. press: prints a question and returns the pressed key.
    feeder: name of the machine that places objects; None if a person places them.
    """

    def __init__(
        self,
        ask: Callable[[str], bool],
        agreed: bool = False,
        tell: Callable[[str], str] | None = None,
        wait: Callable[[str], Guidance] | None = None,
        press: Callable[[str], str] | None = None,
        feeder: str | None = None,
    ) -> None:
        self.feeder = feeder
        self._ask, self._tell, self._wait, self._press = ask, tell, wait, press
        self._agreed = agreed
        self._in_place: str | None = None
        self._before = ""

    def confirm(self, question: str) -> None:
        """Ask, and stop unless they agree; if agreed in advance, print the question on stderr instead."""
        if self._agreed:
            print(f"Agreed in advance: {question}", file=sys.stderr, flush=True)
        elif not self._ask(question):
            raise OperatorStopError(
                "stopped: the operator did not agree; nothing was moved (scripts agree by --bench FILE --yes)"
            )

    def look(self, question: str) -> None:
        """Ask in any case, and stop unless they agree."""
        if not self._ask(question):
            raise OperatorStopError("stopped: the person at the bench did not agree; nothing was moved")

    def place(self, object_id: str, name: str) -> None:
        """Ask for the object to be placed, unless the last lift set it down in its place.

        Agreement in advance covers only the first object: another one, or one that fell, needs a person or
        the feeder.
        """
        if self._in_place == object_id:
            return
        what = f"object {object_id} ({name})"
        if self.feeder is not None:
            _log.info("%s was placed by the feeder '%s'", what, self.feeder)
        elif not self._before:
            self.confirm(f"Place {what} on its mark. Ready?")
        elif not self._ask(f"Place {what} on its mark: {self._before}. Ready?"):
            raise OperatorStopError(
                f"stopped: {self._before}: a person has to place {what}: run this at a terminal, or name a "
                "feeder in the bench file (feeder in [table])"
            )
        self._in_place, self._before = object_id, f"{what} may still be there"

    def hold(
        self,
        question: str,
        object_id: str,
        base_T_tcp: Pose,  # noqa: N803
        opening_m: float | None,
        turning: bool = False,
    ) -> None:
        self._in_place = None
        self.look(question)

    def note_displaced(self, why: str = DISPLACED) -> None:
        self._in_place, self._before = None, why

    def nudge(self, question: str) -> Vector3 | None:
        """Ask for a small motion in mm; an empty line means that the tip sits in its hole."""
        if self._tell is None:
            raise OperatorStopError("stopped: a person at a terminal is needed to guide the tip")
        while words := self._tell(f"{question} x y z in mm, empty when it sits, q to stop:").split():
            if words[0] in ("q", "quit"):
                raise OperatorStopError("stopped by the operator; the arm holds its position")
            try:
                x, y, z = (float(word) / 1e3 for word in words)
            except ValueError:
                continue
            return x, y, z
        return None

    def guide(self, question: str, where: Pose) -> Guidance:
        if self._wait is None:
            raise OperatorStopError("stopped: a person at a terminal is needed to lead the arm")
        return self._wait(f"{question} Enter when it is there, q to stop:")

    def key(self, question: str, where: Pose, here: Pose) -> str:
        if self._press is None:
            raise OperatorStopError("stopped: a person at a terminal is needed to step the arm")
        key = self._press(question)
        if key == "q":
            raise OperatorStopError("stopped by the operator; the arm holds its position")
        return key


def _nearer(where: Pose, here: Pose, size: str) -> str | None:
    """Return the key of a step of this size that moves a tool nearer to a place; None if none does."""
    off_m = np.subtract(where.position_m, here.position_m)
    turn_deg = -float((where.rotation * here.rotation.inv()).as_rotvec(degrees=True)[1])
    offs = {"x": off_m[0] / STEPS_M[size], "y": off_m[1] / STEPS_M[size], "t": turn_deg / STEPS_DEG[size]}
    for key, steps in {**offs, "z": off_m[2] / STEPS_M[size]}.items():
        if abs(steps) > 0.5:
            return key if steps > 0 else key.upper()
    return None
