"""Options of commands that may be looked on at: a page in a browser, a command that is run on events."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from rig.cli.common import say
from rig.live.onlookers import Event, looking_on, tell

if TYPE_CHECKING:
    from rig.live.feed import Listener

WatchOption = Annotated[
    bool, typer.Option("--watch", help="Show it on a page in the browser, on this computer.")
]
WatchAtOption = Annotated[
    str | None,
    typer.Option("--watch-at", help="The same at HOST:PORT; 0.0.0.0:8080 lets other computers look on."),
]
NotifyOption = Annotated[
    str | None,
    typer.Option(
        "--notify", help="Command to run as COMMAND EVENT TEXT on each fault, question and the end."
    ),
]
Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Work:
    """What is looked on at. title: its name. what: its pieces are called. done: of them, before it began."""

    title: str
    what: str
    total: int
    done: int = 0


@contextmanager
def watched(
    context: typer.Context, work: Work, watch: bool, watch_at: str | None, notify: str | None
) -> "Iterator[tuple[Listener, ...]]":
    """Let people look on as they asked for, and give who takes what lifts and poses send.

    The page stays until the command has ended, its report written. Raises `InputError`.
    """
    with ExitStack() as stack:
        listeners: tuple[Listener, ...] = ()
        if notify is not None:
            from rig.live.notify import Notifier

            notifier = stack.enter_context(Notifier(notify, say))
            stack.enter_context(looking_on(notifier.tell))
        if watch or watch_at is not None:
            from rig.live.watch import WatchPage, watch_address

            at = watch_address(watch_at)
            page = WatchPage(at, work.title, work.what, work.done, work.total)
            context.call_on_close(page.close)
            stack.enter_context(looking_on(page.tell))
            say(f"watch it at {page.address}")
            listeners = (page.listener,)
        yield listeners


def telling(
    show: Callable[[int, int, Row], None], note: Callable[[Row], str], fault: Callable[[Row], str | None]
) -> Callable[[int, int, Row], None]:
    """Show each finished piece of work, then tell those who look on of it, and of what failed."""

    def progress(done: int, total: int, row: Row) -> None:
        show(done, total, row)
        tell(Event("progress", note(row), done, total))
        if failed := fault(row):
            tell(Event("fault", failed))

    return progress
