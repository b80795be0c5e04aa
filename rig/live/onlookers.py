"""Who is told what a command does: how far it is, what it asks, what failed, that it ended.

One list for the process, which has one terminal and runs one command. It is empty unless somebody looks on.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from rig.live.screen import set_aside


@dataclass(frozen=True, slots=True)
class Event:
    """What happened. done, total: pieces of work, with "progress" alone."""

    kind: Literal["progress", "question", "answered", "fault", "end"]
    text: str = ""
    done: int = 0
    total: int = 0


Tell = Callable[[Event], None]
"""Takes an event at once; never waits, never raises."""
_onlookers: list[Tell] = []


def tell(event: Event) -> None:
    """Tell everybody who looks on."""
    for onlooker in _onlookers:
        onlooker(event)


@contextmanager
def looking_on(onlooker: Tell) -> Iterator[None]:
    """Have somebody told of all events, the last of them how the work ended."""
    _onlookers.append(onlooker)
    try:
        yield
        onlooker(Event("end", "done"))
    except BaseException as error:
        onlooker(Event("end", str(error) or type(error).__name__))
        raise
    finally:
        _onlookers.remove(onlooker)


@contextmanager
def asked(question: str) -> Iterator[None]:
    """Give the terminal to a question, and let it be known while it waits. question: "" is known already."""
    with set_aside():
        if question:
            tell(Event("question", question))
        try:
            yield
        finally:
            tell(Event("answered"))
