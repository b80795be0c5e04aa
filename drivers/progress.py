"""Progress of a long computation: code names it and counts its steps here, and a display shows both."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sized
from dataclasses import dataclass
from typing import TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Display:
    """Functions of a display. begin: shows the name of work. count: shows the number of finished steps."""

    begin: Callable[[str], None]
    count: Callable[[int, int | None], None]


_display: Display | None = None


def show_on(display: Display | None) -> None:
    """Use a display from now on; None for none."""
    global _display
    _display = display


def begin_work(name: str) -> None:
    """Name the work that begins now. Without a display the name is logged as a warning."""
    display = _display
    if display is None:
        logging.getLogger(__name__).warning(name)
    else:
        display.begin(name)


def name_work(name: str) -> None:
    """Name the work whose steps are counted from now on, on a display only."""
    if _display is not None:
        _display.begin(name)


def count_steps(done: int, total: int | None) -> None:
    """Report the number of finished steps, and of all steps if it is known."""
    display = _display
    if display is not None:
        display.count(done, total)


def steps(items: Iterable[Item], total: int | None = None) -> Iterator[Item]:
    """Yield items, and count each when the next one is asked for. total: their number, if not len(items)."""
    if total is None and isinstance(items, Sized):
        total = len(items)
    for done, item in enumerate(items):
        count_steps(done, total)
        yield item
