"""A running trial on the terminal: its progress and the lifts in progress.

On a terminal this is a display that refreshes. In other output it is a line per finished lift, and a line per
lift in progress every few seconds.
"""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Self

from rich.console import Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from rig.live.feed import Inbox
from rig.live.state import LiftInView, update_lifts
from rig.sessions.records import Lift
from rig.terminal.screen import TimeLeft, begin_phase, left_text, show_display
from rig.terminal.tables import PlainConsole

REFRESH_PER_S = 4.0
PLAIN_EVERY_S = 5.0
USUAL_LIFT_S = 8.0
"""Assumed time from a lift's first to its last frame, until a lift has been measured."""


class TrialView:
    """Shows a running trial. Call it with the finished number, the total number and a finished lift's row.

    note: returns a one-line summary of a lift's outcome. done: number of lifts that an earlier run has
    finished. usual_s: time per lift in that run, if known.
    """

    def __init__(
        self,
        total: int,
        inbox: Inbox,
        note: Callable[[Lift], str],
        done: int = 0,
        usual_s: float | None = None,
    ) -> None:
        console = PlainConsole(stderr=True)
        self._inbox, self._note = inbox, note
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
        self._display = None
        if console.is_terminal:
            settings: dict[str, Any] = {"refresh_per_second": REFRESH_PER_S, "transient": True}
            self._display = Live(console=console, get_renderable=self.render, **settings)
        self._shown, self._over = ExitStack(), threading.Event()

    def __enter__(self) -> Self:
        if self._display is not None:
            self._shown.enter_context(show_display(self._display))
            return self
        begin_phase("lifts: the first one has started")
        thread = threading.Thread(target=self._print_lines, daemon=True, name="live lines")
        thread.start()
        self._shown.callback(thread.join)
        self._shown.callback(self._over.set)
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.close()

    def __call__(self, done: int, total: int, row: Lift) -> None:
        self._read()
        with self._lock:
            self._time_left.done, self._time_left.total = done, total
            for sender in [s for s, lift in self._lifts.items() if lift.number == row.number]:
                self._spans_s.append(self._lifts.pop(sender).seen_s)
        text = f"{done}/{total} {self._note(row)}"
        if self._display is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._display.console.print(text, highlight=False)

    def render(self) -> Group:
        """Return the progress bar, followed by two lines per lift in progress, in the order of the lifts."""
        lifts, left = self._read()
        done, total = self._time_left.done, self._time_left.total
        self._progress.update(self._task, completed=done, total=total, left=left)
        return Group(self._progress, *(Text(f"{lift.angles()}\n    {lift.frames()}") for lift in lifts))

    def lines(self) -> list[str]:
        """Return a line for each lift in progress, with the time left."""
        lifts, left = self._read()
        end = f"; {left}" if left else ""
        return [f"{lift.angles()}; {lift.frames()}{end}" for lift in lifts if lift.phase]

    def _print_lines(self) -> None:
        while not self._over.wait(PLAIN_EVERY_S):
            for line in self.lines():
                print(line, file=sys.stderr, flush=True)

    def _read(self) -> tuple[list[LiftInView], str]:
        """Process new messages; return the lifts in order, and the time left. Two threads call this."""
        with self._lock:
            for message in self._inbox.take():
                if not self._begun:  # earlier questions do not count in the time left
                    self._begun = True
                    self._time_left.begin()
                update_lifts(self._lifts, message)
            lifts = sorted(self._lifts.values(), key=lambda lift: lift.number)
            seen = [span for span in self._spans_s if span > 0.0]
        whole_s = sum(seen) / len(seen) if seen else USUAL_LIFT_S
        return lifts, left_text(self._time_left.seconds(tuple(lift.seen_s / whole_s for lift in lifts)))
