"""What the page of `--watch` shows: the newest of everything, and nothing else is kept."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from rig.live.feed import Message
from rig.live.onlookers import Event
from rig.live.terminal import LiftInView

KEPT_FAULTS = 20
KEPT_LIFTS = 16
"""Processes whose newest lift is shown."""
SILENT_S = 3.0
"""Pictures are those of one process; after so long without any, those of another."""


@dataclass(slots=True)
class WatchState:
    """What is known now. take: gives what came of lifts since it was last asked, oldest first.

    title: of the command, as people know it. what: pieces of work are called, as "lifts". Asked by threads
    of the server, told by the command's.
    """

    title: str
    what: str
    done: int
    total: int
    take: Callable[[], list[Message]]
    newest: str = ""
    question: str = ""
    ended: str = ""
    faults: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT_FAULTS))
    _lifts: dict[int, LiftInView] = field(default_factory=dict)
    _pictures: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    _followed: int | None = None
    _followed_at_s: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def tell(self, event: Event) -> None:
        """Take an event."""
        with self._lock:
            if event.kind == "progress":
                self.newest, self.done, self.total = event.text, event.done, event.total
            elif event.kind == "fault":
                self.faults.appendleft(f"{datetime.now():%H:%M:%S} {event.text}")
            elif event.kind == "end":
                self.ended, self.question = event.text, ""
            else:
                self.question = event.text

    def values(self) -> dict[str, Any]:
        """Return everything but the pictures, as JSON takes it."""
        with self._lock:
            self._read()
            lifts = sorted(self._lifts.values(), key=lambda lift: lift.number)
            return {
                "title": self.title,
                "what": self.what,
                "done": self.done,
                "total": self.total,
                "newest": self.newest,
                "question": self.question,
                "ended": self.ended,
                "faults": list(self.faults),
                "lifts": [_shown(lift) for lift in lifts],
                "pictures": {serial: number for serial, (number, _) in self._pictures.items()},
            }

    def picture(self, serial: str) -> bytes | None:
        """Return the newest JPEG of a source; None where there is none."""
        with self._lock:
            self._read()
            return self._pictures.get(serial, (0, None))[1]

    def _read(self) -> None:
        for message in self.take():
            if message.picture:
                self._keep_picture(message)
            elif "number" in message.values:
                self._keep_lift(message)

    def _keep_picture(self, message: Message) -> None:
        now_s, sender, serial = time.monotonic(), message.values["sender"], message.values["serial"]
        if sender != self._followed and self._followed is not None and now_s < self._followed_at_s + SILENT_S:
            return
        self._followed, self._followed_at_s = sender, now_s
        self._pictures[serial] = (self._pictures.get(serial, (0, b""))[0] + 1, message.picture)

    def _keep_lift(self, message: Message) -> None:
        values = message.values
        lift = self._lifts.get(values["sender"])
        if lift is None or lift.number != values["number"]:
            self._lifts.pop(values["sender"], None)
            title = f"{values['object']} {values['name']} lift {values['lift']}"
            lift = self._lifts[values["sender"]] = LiftInView(values["number"], title)
            if len(self._lifts) > KEPT_LIFTS:
                self._lifts.pop(next(iter(self._lifts)))
        lift.take(message)


def _shown(lift: LiftInView) -> dict[str, Any]:
    return {
        "title": lift.title,
        "phase": lift.phase,
        "estimate_deg": lift.estimate_deg,
        "truth_deg": lift.truth_deg,
        "frames": lift.frames(),
    }
