"""Observers of a command's events: progress, questions, faults, end.

There is one list per process, because a process has one terminal and runs one command. It is empty by
default.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from rig.terminal.screen import set_aside


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a command. done, total: numbers of pieces of work, only for "progress"."""

    kind: Literal["progress", "question", "answered", "fault", "end"]
    text: str = ""
    done: int = 0
    total: int = 0


Row = TypeVar("Row")
Observer = Callable[[Event], None]
"""Takes an event; never blocks, never raises."""
_observers: list[Observer] = []
_report_pages: list[Callable[[Path], None]] = []
"""Functions that show the report of the command once it is written."""


def announce(event: Event) -> None:
    for observer in _observers:
        observer(event)


def announcing(
    show: Callable[[int, int, Row], None], note: Callable[[Row], str], fault: Callable[[Row], str | None]
) -> Callable[[int, int, Row], None]:
    """Return a function that shows each finished piece of work, then passes it and its fault to observers."""

    def progress(done: int, total: int, row: Row) -> None:
        show(done, total, row)
        announce(Event("progress", note(row), done, total))
        if failed := fault(row):
            announce(Event("fault", failed))

    return progress


@contextmanager
def observed_by(observer: Observer) -> Iterator[None]:
    """Pass all events to an observer, finally one with the outcome of the command."""
    _observers.append(observer)
    try:
        yield
        observer(Event("end", "done"))
    except BaseException as error:
        observer(Event("end", str(error) or type(error).__name__))
        raise
    finally:
        _observers.remove(observer)


def report_to(page: Callable[[Path], None]) -> Callable[[], None]:
    """Pass the path of the command's report to `page` when it is written; return a function to cancel."""
    _report_pages.append(page)
    return lambda: _report_pages.remove(page)


def report_written(file: Path) -> None:
    for page in _report_pages:
        page(file)


@contextmanager
def announce_question(question: str) -> Iterator[None]:
    """Free the terminal for a question, and send it to observers unless it is "" (sent before)."""
    with set_aside():
        if question:
            announce(Event("question", question))
        try:
            yield
        finally:
            announce(Event("answered"))
