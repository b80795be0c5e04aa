"""Let people watch a command: a page in the browser, and a command that is run on events."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import typer

from rig.cli.common import say
from rig.cli.options import WatchOptions
from rig.live.onlookers import Event, looking_on, tell

if TYPE_CHECKING:
    from rig.live.feed import Listener

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Work:
    """What is looked on at. title: its name. what: its pieces are called. done: of them, before it began."""

    title: str
    what: str
    total: int
    done: int = 0


@contextmanager
def watched(context: typer.Context, work: Work, options: WatchOptions) -> "Iterator[tuple[Listener, ...]]":
    """Serve the page and start the command that were asked for; yield the listeners of lifts and poses.

    The page stays until the command has ended, its report written. Raises `InputError`.
    """
    with ExitStack() as stack:
        listeners: tuple[Listener, ...] = ()
        if options.notify is not None:
            from rig.live.notify import Notifier

            notifier = stack.enter_context(Notifier(options.notify, say))
            stack.enter_context(looking_on(notifier.tell))
        if options.watch or options.watch_at is not None:
            from rig.live.watch import WatchPage, watch_address

            at = watch_address(options.watch_at)
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
