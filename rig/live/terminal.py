"""Progress of work on the terminal, and for a trial the lifts in progress.

On a terminal this is a display that refreshes. In other output it is a line per finished piece of work, and
for a trial a line per lift in progress every few seconds.
"""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Generic, Self, TypeVar

from rich.console import Group
from rich.live import Live
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from drivers.errors import without_values
from rig.live.console import PlainConsole
from rig.live.feed import Inbox
from rig.live.lift_in_view import LiftInView
from rig.live.screen import begin_phase, end_phase, shown
from rig.live.time_left import TimeLeft, left_text
from rig.sessions.records import LiftRow

Row = TypeVar("Row")

REFRESH_PER_S = 4.0
PLAIN_EVERY_S = 5.0
USUAL_LIFT_S = 8.0
"""Assumed time from a lift's first to its last frame, until a lift has been measured."""


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
        """Show the number of finished pieces, and the result of the last one."""
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
        """Return the line."""
        fault, text = self._fault(row), self._note(row)
        if fault is None:
            return text
        if (cause := without_values(fault)) in self._printed:
            return text.replace(fault, "the same fault again")
        self._printed.add(cause)
        return text


class TrainingView:
    """A line per epoch, and between the lines the step with its finished percentage and the time left."""

    def __init__(self) -> None:
        self._left, self._text = TimeLeft(100), ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        end_phase()

    def __call__(self, text: str, share: float) -> None:
        """Show the step and the finished fraction of the training."""
        percent = round(100.0 * share)
        self._left.piece_done(percent, 100)
        if "loss" in text:
            end_phase()
            print(text, file=sys.stderr, flush=True)
            begin_phase("training, percent", left=self._left)
        elif text != self._text:
            begin_phase(f"{text}, percent", left=self._left)
        self._text = text


class TrialView:
    """Shows a running trial. Call it with the finished number, the total number and a finished lift's row.

    note: returns a one-line summary of a lift's outcome. done: number of lifts that an earlier run has
    finished. usual_s: time per lift in that run, if known.
    """

    def __init__(
        self,
        total: int,
        inbox: Inbox,
        note: Callable[[LiftRow], str],
        done: int = 0,
        usual_s: float | None = None,
    ) -> None:
        console = PlainConsole(stderr=True)
        self._inbox = inbox
        self._note = note
        self._lock = threading.Lock()
        self._lifts: dict[int, LiftInView] = {}
        self._progress = Progress(
            TextColumn("lifts"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"), console=console,
        )  # fmt: skip
        self._task = self._progress.add_task("lifts", total=total, completed=done, left="")
        self._time_left = TimeLeft(total, done, usual_s=usual_s)
        self._spans_s: list[float] = []
        self._begun = False
        self._shown = _Refreshed(console, self.render) if console.is_terminal else _Plain(self.lines)

    def __enter__(self) -> Self:
        self._shown.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.stop()

    def __call__(self, done: int, total: int, row: LiftRow) -> None:
        """Show a finished lift."""
        self._read()
        with self._lock:
            self._time_left.done, self._time_left.total = done, total
            over = [sender for sender, lift in self._lifts.items() if lift.number == row.number]
            for sender in over:
                self._spans_s.append(self._lifts.pop(sender).seen_s)
        self._shown.line(f"{done}/{total} {self._note(row)}")

    def render(self) -> Group:
        """Return the progress bar, followed by two lines per lift in progress, in the order of the lifts."""
        self._read()
        lifts = self._in_order()
        self._progress.update(
            self._task,
            completed=self._time_left.done,
            total=self._time_left.total,
            left=left_text(self._left_s(lifts)),
        )
        lines = [Text(line) for lift in lifts for line in (lift.angles(), f"    {lift.frames()}")]
        return Group(self._progress, *lines)

    def lines(self) -> list[str]:
        """Return a line for each lift in progress, with the time left."""
        self._read()
        lifts = self._in_order()
        left = left_text(self._left_s(lifts))
        end = f"; {left}" if left else ""
        return [f"{lift.angles()}; {lift.frames()}{end}" for lift in lifts if lift.phase]

    def _in_order(self) -> list[LiftInView]:
        with self._lock:
            return sorted(self._lifts.values(), key=lambda lift: lift.number)

    def _left_s(self, lifts: list[LiftInView]) -> float | None:
        seen = [span for span in self._spans_s if span > 0.0]
        whole_s = sum(seen) / len(seen) if seen else USUAL_LIFT_S
        return self._time_left.seconds(tuple(lift.seen_s / whole_s for lift in lifts))

    def _read(self) -> None:
        """Process new messages; called by the trial and by the thread that draws."""
        with self._lock:
            for message in self._inbox.take():
                self._begin_once()
                values = message.values
                lift = self._lifts.get(values["sender"])
                if lift is None or lift.number != values["number"]:
                    title = f"{values['object']} {values['name']} lift {values['lift']}"
                    lift = self._lifts[values["sender"]] = LiftInView(values["number"], title)
                lift.take(message)

    def _begin_once(self) -> None:
        """Start the estimate of the remaining time at the first lift; earlier questions do not count."""
        if not self._begun:
            self._begun = True
            self._time_left.begin()


class _Refreshed:
    """A part of the terminal that a thread of rich refreshes."""

    def __init__(self, console: PlainConsole, render: Callable[[], Group]) -> None:
        self._live = Live(
            console=console, get_renderable=render, refresh_per_second=REFRESH_PER_S, transient=True
        )
        self._shown = ExitStack()

    def start(self) -> None:
        self._shown.enter_context(shown(self._live))

    def stop(self) -> None:
        self._shown.close()

    def line(self, text: str) -> None:
        self._live.console.print(text, highlight=False)


class _Plain:
    """Lines on standard error: finished lifts at once, lifts in progress every `PLAIN_EVERY_S`."""

    def __init__(self, lines: Callable[[], list[str]]) -> None:
        self._lines = lines
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._repeat, daemon=True, name="live lines")

    def start(self) -> None:
        begin_phase("lifts: the first one has started")
        self._thread.start()

    def stop(self) -> None:
        self._over.set()
        self._thread.join()

    def line(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def _repeat(self) -> None:
        while not self._over.wait(PLAIN_EVERY_S):
            for line in self._lines():
                self.line(line)
