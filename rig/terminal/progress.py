"""Progress of work on standard error: a line per finished piece, and between the lines the time left."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, Self, TypeVar

from drivers.errors import without_values
from rig.terminal.screen import TimeLeft, begin_phase, end_phase

Row = TypeVar("Row")


class WorkProgress:
    """A line per finished piece of work, and between the lines the number of pieces and the time left."""

    def __init__(self, total: int, what: str) -> None:
        self._what, self._left = what, TimeLeft(total)

    def __enter__(self) -> Self:
        begin_phase(f"{self._what}: the first one has started")
        return self

    def __exit__(self, *_: object) -> None:
        end_phase()

    def show(self, done: int, total: int, note: str) -> None:
        end_phase()
        print(f"{done}/{total} {note}", file=sys.stderr, flush=True)
        self._left.piece_done(done, total)
        if done < total:
            begin_phase(self._what, left=self._left)

    def showing(self, note: Callable[[Row], str]) -> Callable[[int, int, Row], None]:
        """Return a function that shows a finished piece of work. note: returns the text of its result."""
        return lambda done, total, row: self.show(done, total, note(row))


class OneMessage(Generic[Row]):
    """Returns the result of each attempt as a line; a fault with a cause that was printed is abbreviated.

    note: returns the result, including the fault. fault: returns the fault that ended an attempt, else None.
    """

    def __init__(self, note: Callable[[Row], str], fault: Callable[[Row], str | None]) -> None:
        self._note, self._fault = note, fault
        self._printed: set[str] = set()

    def __call__(self, row: Row) -> str:
        fault, text = self._fault(row), self._note(row)
        if fault is None:
            return text
        if (cause := without_values(fault)) in self._printed:
            return text.replace(fault, "the same fault again")
        self._printed.add(cause)
        return text


@contextmanager
def training_view() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows the step and the finished fraction of a training.

    It prints a line per epoch, and between the lines the step with its percentage and the time left.
    """
    left, newest = TimeLeft(100), ""

    def show(text: str, share: float) -> None:
        nonlocal newest
        left.piece_done(round(100.0 * share), 100)
        if "loss" in text:
            end_phase()
            print(text, file=sys.stderr, flush=True)
            begin_phase("training, percent", left=left)
        elif text != newest:
            begin_phase(f"{text}, percent", left=left)
        newest = text

    try:
        yield show
    finally:
        end_phase()
