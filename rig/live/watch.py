"""The page of `--watch`: read-only, in a process of its own, so that no browser is ever waited for."""

import json
import socket
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import partial
from ipaddress import ip_address
from typing import Any
from urllib.parse import unquote

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from rig.live.feed import Inbox, Listener, Message
from rig.live.onlookers import Event
from rig.live.terminal import LiftInView
from rig.pages.page import render
from rig.pages.serving import LOOPBACK, NOT_ALLOWED, NOT_FOUND, Answer, PageProcess, Request

KEPT_FAULTS, MOST_CHARACTERS = 20, 2000
KEPT_LIFTS = 16
"""Processes whose newest lift is shown."""
POINTS_APART_S, KEPT_POINTS = 0.05, 600
"""Of the curve of a lift's angles: no more than a screen shows, and the newest half minute of them."""
SILENT_S = 3.0
"""Pictures are those of one process; after so long without any, those of another."""


Curve = deque[tuple[float, float | None]]
"""Times in s from a lift's first frame, angles in degrees, None where there was no answer."""


@dataclass(slots=True)
class LiftOnPage:
    """A lift in progress, with its angles so far."""

    lift: LiftInView
    estimate: Curve = field(default_factory=lambda: deque(maxlen=KEPT_POINTS))
    truth: Curve = field(default_factory=lambda: deque(maxlen=KEPT_POINTS))

    def take(self, message: Message) -> None:
        """Bring it up to date."""
        self.lift.take(message)
        if message.kind == "figures":
            for curve, points in ((self.estimate, "estimate"), (self.truth, "truth")):
                for time_ns, angle_deg, *_ in message.values[points]:
                    self._add(curve, time_ns, angle_deg)

    def values(self) -> dict[str, Any]:
        """Return it as the page takes it."""
        return {
            "title": self.lift.title,
            "phase": self.lift.phase,
            "estimate_deg": self.lift.estimate_deg,
            "truth_deg": self.lift.truth_deg,
            "frames": self.lift.frames(),
            "estimate": list(self.estimate),
            "truth": list(self.truth),
        }

    def _add(self, curve: Curve, time_ns: int, angle_deg: float | None) -> None:
        time_s = round((time_ns - (self.lift.began_ns or 0)) / NS_PER_S, 2)
        answered = angle_deg is not None
        if curve and time_s < curve[-1][0] + POINTS_APART_S and answered == (curve[-1][1] is not None):
            return
        curve.append((time_s, None if angle_deg is None else round(angle_deg, 2)))


@dataclass(frozen=True, slots=True)
class Progress:
    """State of a command for the page. title: its name. what: name of its pieces of work, as "lifts".

    newest: about the piece finished last. question: that waits for an answer. ended: how the command ended.
    faults: newest first, with the time of day.
    """

    title: str
    what: str
    done: int
    total: int
    newest: str = ""
    question: str = ""
    ended: str = ""
    faults: Sequence[str] = ()

    def after(self, event: Event) -> "Progress":
        """Return the progress after an event."""
        text = event.text[:MOST_CHARACTERS]
        if event.kind == "progress":
            return replace(self, newest=text, done=event.done, total=event.total)
        if event.kind == "fault":
            faults = (f"{datetime.now():%H:%M:%S} {text}", *self.faults)
            return replace(self, faults=faults[:KEPT_FAULTS])
        if event.kind == "end":
            return replace(self, ended=text, question="")
        return replace(self, question=text)


@dataclass(slots=True)
class WatchState:
    """What is shown now. take: returns the messages of lifts since the last call, oldest first."""

    progress: Progress
    take: Callable[[], list[Message]]
    _lifts: dict[int, LiftOnPage] = field(default_factory=dict)
    _pictures: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    _followed: int | None = None
    _followed_at_s: float = 0.0

    def values(self) -> dict[str, Any]:
        """Return everything but the pictures, as JSON takes it."""
        self._read()
        lifts = sorted(self._lifts.values(), key=lambda each: each.lift.number)
        return {
            **asdict(self.progress),
            "lifts": [lift.values() for lift in lifts],
            "pictures": {serial: number for serial, (number, _) in self._pictures.items()},
        }

    def picture(self, serial: str) -> bytes | None:
        """Return the newest JPEG of a source; None where there is none."""
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
        known = self._lifts.get(values["sender"])
        if known is None or known.lift.number != values["number"]:
            self._lifts.pop(values["sender"], None)
            title = f"{values['object']} {values['name']} lift {values['lift']}"
            known = self._lifts[values["sender"]] = LiftOnPage(LiftInView(values["number"], title))
            if len(self._lifts) > KEPT_LIFTS:
                self._lifts.pop(next(iter(self._lifts)))
        known.take(message)


def watch_address(at: str | None) -> tuple[str, int]:
    """Return host and port of the page; port 0 is a free one.

    at: as typed, HOST:PORT, None for this computer alone. Raises `InputError` for anything else.
    """
    if at is None:
        return LOOPBACK, 0
    host, _, port = at.rpartition(":")
    if not host or not (port.isascii() and port.isdecimal()) or len(port) > 5 or int(port) > 65535:
        raise InputError(f"--watch-at {at}: write host and port, as {LOOPBACK}:8080")
    return host, int(port)


class WatchPage:
    """Serves what happens at `address` until it is closed. `listener`: lifts and poses send to it.

    at: host and port. title, what, done, total: as `Progress`. Raises `InputError` for an address that
    cannot be served.
    """

    def __init__(self, at: tuple[str, int], title: str, what: str, done: int, total: int) -> None:
        self._progress = Progress(title, what, done, total)
        self._folder = tempfile.TemporaryDirectory(prefix="rig-watch-")
        self.listener = Listener(f"{self._folder.name}/page", pictures=True)
        try:
            self.process = PageProcess(partial(Watched, self._progress, self.listener.address), at)
        except (OSError, UnicodeError) as error:
            self._folder.cleanup()
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"--watch-at {at[0]}:{at[1]}: nothing can be served there ({why}); choose another address"
            ) from error
        host = socket.gethostname() if ip_address(self.process.host).is_unspecified else at[0]
        self.address = f"http://{host}:{self.process.port}/"

    def tell(self, event: Event) -> None:
        """Show an event; never blocks. Each message has the complete progress, so a lost one does no harm."""
        self._progress = self._progress.after(event)
        self.process.send(json.dumps(asdict(self._progress)).encode())

    def close(self) -> None:
        """Stop serving."""
        self.process.close()
        self._folder.cleanup()


class Watched:
    """The page, in its own process. progress: of the command so far. address: lifts and poses send there."""

    def __init__(self, progress: Progress, address: str) -> None:
        self._html = render("rig.live", "watch.html", title=progress.title).encode()
        self._inbox = Inbox(address)
        self._state = WatchState(progress, self._inbox.take)

    def take(self, message: bytes) -> None:
        """Take the command's progress."""
        self._state.progress = Progress(**json.loads(message))

    def answer(self, request: Request) -> Answer:
        """Answer a request; nothing can be changed from the page."""
        if request.method != "GET":
            return NOT_ALLOWED
        if request.path == "/":
            return Answer(self._html, "text/html; charset=utf-8")
        if request.path == "/state.json":
            return Answer(json.dumps(self._state.values()).encode(), "application/json")
        return self._picture(request.path)

    def close(self) -> None:
        """Stop receiving."""
        self._inbox.close()

    def _picture(self, path: str) -> Answer:
        name = unquote(path.removeprefix("/picture/").removesuffix(".jpg"))
        picture = self._state.picture(name)
        return NOT_FOUND if picture is None or path == name else Answer(picture, "image/jpeg")
