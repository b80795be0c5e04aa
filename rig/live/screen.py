"""The part of the terminal that is drawn anew: it gives way to a question, which it would erase."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rig.live.plain_text import PlainStream

if TYPE_CHECKING:
    from rich.live import Live

_shown: "list[Live]" = []
"""The displays that are on the terminal now: of this process, which has one terminal."""


@contextmanager
def shown(display: "Live") -> Iterator[None]:
    """Show a display, and know of it while it is shown."""
    _start(display)
    _shown.append(display)
    try:
        yield
    finally:
        _shown.remove(display)
        display.stop()


@contextmanager
def set_aside() -> Iterator[None]:
    """Take all displays off the terminal for as long as something is asked there, then show them again."""
    paused = [(display, display.transient, display.vertical_overflow) for display in _shown]
    for display, _, _ in paused:
        display.transient = True  # what is left behind would stand over the question
        display.stop()
    try:
        yield
    finally:
        for display, transient, overflow in paused:
            display.transient, display.vertical_overflow = transient, overflow
            _start(display)


def _start(display: "Live") -> None:
    """Show a display; it takes over both streams and would interpret escape sequences printed there."""
    display.start()
    sys.stdout, sys.stderr = PlainStream(sys.stdout), PlainStream(sys.stderr)  # type: ignore[assignment]
