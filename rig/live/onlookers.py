"""Observers of a command's events: progress, questions, faults, its end.

One list per process, which has one terminal and runs one command. By default it is empty.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from rig.live.screen import set_aside


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a command. done, total: pieces of work, only for "progress"."""

    kind: Literal["progress", "question", "answered", "fault", "end"]
    text: str = ""
    done: int = 0
    total: int = 0


Row = TypeVar("Row")
Tell = Callable[[Event], None]
"""Takes an event; never blocks, never raises."""
_onlookers: list[Tell] = []
_report_pages: list[Callable[[Path], None]] = []
"""Each shows the report of the command that has just written it."""


def tell(event: Event) -> None:
    """Pass an event to all observers."""
    for onlooker in _onlookers:
        onlooker(event)


def telling(
    show: Callable[[int, int, Row], None], note: Callable[[Row], str], fault: Callable[[Row], str | None]
) -> Callable[[int, int, Row], None]:
    """Return a function that shows each finished piece of work, then sends it and its fault to onlookers."""

    def progress(done: int, total: int, row: Row) -> None:
        show(done, total, row)
        tell(Event("progress", note(row), done, total))
        if failed := fault(row):
            tell(Event("fault", failed))

    return progress


@contextmanager
def looking_on(onlooker: Tell) -> Iterator[None]:
    """Pass all events to an observer, at last how the work ended."""
    _onlookers.append(onlooker)
    try:
        yield
        onlooker(Event("end", "done"))
    except BaseException as error:
        onlooker(Event("end", str(error) or type(error).__name__))
        raise
    finally:
        _onlookers.remove(onlooker)


def report_to(page: Callable[[Path], None]) -> Callable[[], None]:
    """Pass the path of the command's report to a page once it is written; return what ends that."""
    _report_pages.append(page)
    return lambda: _report_pages.remove(page)


def report_written(file: Path) -> None:
    """Pass the path of the command's report on."""
    for page in _report_pages:
        page(file)


@contextmanager
def asked(question: str) -> Iterator[None]:
    """Free the terminal for a question, and announce it unless it is "", which was announced before."""
    with set_aside():
        if question:
            tell(Event("question", question))
        try:
            yield
        finally:
            tell(Event("answered"))
