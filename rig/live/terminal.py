"""The terminal's view of a trial: how far it is, and the lifts in progress.

On a terminal a table that refreshes; elsewhere a plain line now and then, and one per finished lift.
"""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from rig.live.feed import Inbox, Message
from rig.live.screen import shown
from rig.sessions.records import LiftRow

REFRESH_PER_S = 4.0
PLAIN_EVERY_S = 5.0
SPEED_OVER_S = 3600.0
"""The time left follows from the lifts finished within this time."""


@dataclass(slots=True)
class LiftInView:
    """What is known of a lift in progress; angles in degrees, None where there is no answer."""

    number: int
    title: str
    phase: str = ""
    estimate_deg: float | None = None
    truth_deg: float | None = None
    rates_hz: dict[str, float | None] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)

    def take(self, message: Message) -> None:
        """Bring the lift up to date."""
        values = message.values
        self.phase = values.get("phase", self.phase)
        if message.kind == "figures":
            self.rates_hz, self.dropped = values["rates_hz"], values["dropped"]
            if values["estimate"]:
                self.estimate_deg = values["estimate"][-1][1]
            if values["truth"]:
                self.truth_deg = values["truth"][-1][1]

    def cells(self) -> tuple[str, ...]:
        """Return lift, phase, estimate, markers, frames a second and dropped frames, as texts."""
        rates = " ".join("-" if rate is None else f"{rate:.0f}" for rate in self.rates_hz.values())
        return (
            self.title, self.phase, _degrees(self.estimate_deg), _degrees(self.truth_deg), rates,
            str(sum(self.dropped.values())),
        )  # fmt: skip


class TrialView:
    """Shows a trial while it runs; call it with lifts done, lifts wanted and a finished lift's row.

    note: says in a few words what came of a lift.
    """

    def __init__(self, total: int, inbox: Inbox, note: Callable[[LiftRow], str]) -> None:
        console = Console(stderr=True)
        self._inbox = inbox
        self._note = note
        self._lock = threading.Lock()
        self._lifts: dict[int, LiftInView] = {}
        self._progress = Progress(
            TextColumn("lifts"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=False), TextColumn("left"), console=console,
            speed_estimate_period=SPEED_OVER_S,
        )  # fmt: skip
        self._task = self._progress.add_task("lifts", total=total)
        self._shown = _Refreshed(console, self.render) if console.is_terminal else _Plain(self.lines)

    def __enter__(self) -> Self:
        self._shown.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.stop()

    def __call__(self, done: int, total: int, row: LiftRow) -> None:
        """Take a finished lift."""
        self._progress.update(self._task, completed=done, total=total)
        self._read()
        with self._lock:
            over = [sender for sender, lift in self._lifts.items() if lift.number == row.number]
            for sender in over:
                del self._lifts[sender]
        self._shown.line(f"{done}/{total} {self._note(row)}")

    def render(self) -> Group:
        """Return the progress bar over the table of lifts in progress."""
        self._read()
        table = Table(box=None, pad_edge=False)
        for heading in ("lift", "phase", "estimate", "markers", "frames/s", "dropped"):
            table.add_column(
                heading, justify="left" if heading in ("lift", "phase") else "right", min_width=8
            )
        for lift in list(self._lifts.values()):
            table.add_row(*lift.cells())
        return Group(self._progress, table)

    def lines(self) -> list[str]:
        """Return a line for each lift in progress, with the time left."""
        self._read()
        left = self._progress.tasks[0].time_remaining
        end = "" if left is None else f", about {left:.0f} s left"
        return [
            "{}, phase {}: estimate {}, markers {}; {} frames/s, {} dropped".format(*lift.cells()) + end
            for lift in list(self._lifts.values())
            if lift.phase
        ]

    def _read(self) -> None:
        """Take what came; called by the trial and by the thread that draws."""
        with self._lock:
            for message in self._inbox.take():
                values = message.values
                lift = self._lifts.get(values["sender"])
                if lift is None or lift.number != values["number"]:
                    title = f"{values['object']} {values['name']} lift {values['lift']}"
                    lift = self._lifts[values["sender"]] = LiftInView(values["number"], title)
                lift.take(message)


class _Refreshed:
    """A part of the terminal that is drawn anew, by a thread of rich."""

    def __init__(self, console: Console, render: Callable[[], Group]) -> None:
        self._live = Live(
            console=console, get_renderable=render, refresh_per_second=REFRESH_PER_S, transient=True
        )
        self._shown = ExitStack()

    def start(self) -> None:
        self._shown.enter_context(shown(self._live))

    def stop(self) -> None:
        self._shown.close()

    def line(self, text: str) -> None:
        self._live.console.print(text, highlight=False, markup=False)


class _Plain:
    """Lines on standard error: what has finished at once, what is in progress now and then."""

    def __init__(self, lines: Callable[[], list[str]]) -> None:
        self._lines = lines
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True, name="live lines")

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._over.set()
        self._thread.join()

    def line(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def _tell(self) -> None:
        while not self._over.wait(PLAIN_EVERY_S):
            for line in self._lines():
                self.line(line)


def _degrees(angle: float | None) -> str:
    return "-" if angle is None else f"{angle:+.1f} deg"
