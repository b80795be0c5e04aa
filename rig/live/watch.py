"""The page of `--watch`, `rig live` and `rig show`. A separate process serves it, so commands never wait.

It is read-only, except that the page of `rig live` also passes on the actions of its buttons.
"""

import json
import re
import socket
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import unquote

from drivers.errors import InputError, RigError
from rig.live.feed import ESTIMATOR, MARK, RECORD, REFERENCE, SAVE, TAKE_BACKGROUND, Inbox, Listener
from rig.live.state import History, Progress, StateNews, WatchState
from rig.pages.page import render
from rig.pages.requests import FORBIDDEN, LOOPBACK, NOT_ALLOWED, NOT_FOUND, Answer, Request
from rig.pages.serving import PageProcess
from rig.terminal.onlookers import Event

REPORT_WAIT_S = 1.5
"""Time that a connected browser gets to fetch the report before the server stops."""
READ_EVERY_S = 0.1
"""Interval at which messages are read without a browser, so that the history is complete."""
_MARK_AT = re.compile(rf"{MARK} [0-9]{{1,10}}\.[0-9]{{6}}")
"""The action that marks a moment, with its time in s."""
LOOKING, REPORT_SHOWN = b"looking", b"report shown"
"""Messages of the server's process: a browser has opened the page; a browser has fetched the report."""


def watch_address(at: str | None) -> tuple[str, int]:
    """Return host and port to serve at; port 0 stands for any free port.

    at: value of --watch-at, HOST:PORT, or None for a free port on this computer only. Raises `InputError` for
    anything else.
    """
    if at is None:
        return LOOPBACK, 0
    host, _, typed = at.rpartition(":")
    if not host or not (typed.isascii() and typed.isdecimal()) or len(typed) > 5 or int(typed) > 65535:
        raise InputError(f"--watch-at {at}: write host and port, as {LOOPBACK}:8080")
    return host, int(typed)


class WatchPage:
    """Serves the page at `address` until it is closed. Lifts and poses send their messages to `listener`.

    at: host and port. title, what, done, total: see `Progress`. estimators: names to choose from on a page
    with buttons, see `take_action`; without them the page is read-only. history: of a stored clip. If other
    computers can reach the page, `address` contains its key. Raises `InputError` for an address that cannot
    be served.
    """

    def __init__(
        self,
        at: tuple[str, int],
        title: str,
        what: str = "",
        done: int = 0,
        total: int = 0,
        estimators: Sequence[str] = (),
        history: History | None = None,
    ) -> None:
        self._progress = Progress(title, what, done, total)
        self._folder = tempfile.TemporaryDirectory(prefix="rig-watch-")
        self.listener = Listener(f"{self._folder.name}/page", pictures=True)
        try:
            made = partial(Watched, self._progress, self.listener.address, tuple(estimators), history)
            self.process = PageProcess(made, at)
        except (OSError, UnicodeError) as error:
            self._folder.cleanup()
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"--watch-at {at[0]}:{at[1]}: nothing can be served there ({why}); choose another address"
            ) from error
        host = socket.gethostname() if ip_address(self.process.host).is_unspecified else at[0]
        query = self.process.access.query
        self.address = f"http://{host}:{self.process.port}/{query and f'?{query}'}"

    def show_event(self, event: Event) -> None:
        """Show an event; never blocks. Each message has the complete progress, so a lost one does no harm."""
        self._show(self._progress.after(event))

    def show_report(self, file: Path) -> None:
        """Let connected browsers show a report, a single file, from now on."""
        self._show(replace(self._progress, report=str(file.absolute())))

    def _show(self, progress: Progress) -> None:
        self._progress = progress
        self.process.send(json.dumps(asdict(progress)).encode())

    def take_action(self) -> str | None:
        """Return the action of a pressed button, None if there is none; never blocks. Raises `RigError`."""
        report = self.process.receive(0.0)
        return None if report in (None, LOOKING) else str(report, errors="replace")

    def close(self) -> None:
        """Stop serving. If there is a report and a connected browser, wait until it has fetched it."""
        if self._progress.report:
            with suppress(RigError):
                report = self.process.receive(0.0)
                while report and report != REPORT_SHOWN:
                    report = self.process.receive(REPORT_WAIT_S)
        self.process.close()
        self._folder.cleanup()


class Watched:
    """The request handler of the page, in the server's process.

    progress: of the command so far. address: receives the messages of lifts, poses and sensors. estimators,
    history: see `WatchPage`.
    """

    def __init__(
        self,
        progress: Progress,
        address: str,
        estimators: tuple[str, ...] = (),
        history: History | None = None,
    ) -> None:
        names = (REFERENCE, TAKE_BACKGROUND, RECORD, SAVE, *(f"{ESTIMATOR} {name}" for name in estimators))
        self._actions = frozenset(names if estimators else ())
        shown = {"title": progress.title, "estimators": estimators}
        self._html = render("rig.live", "watch.html", **shown, stored=history is not None).encode()
        self._inbox = Inbox(address)
        self._state = WatchState(progress, self._inbox.take, history or History())
        self._over = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True, name="history")
        self._reader.start()

    def take(self, message: bytes) -> None:
        self._state.progress = Progress(**json.loads(message))

    def answer(self, request: Request) -> Answer:
        if request.method == "POST" and request.path == "/do" and self._actions:
            action = request.body.decode(errors="replace")
            if not (action in self._actions or _MARK_AT.fullmatch(action)):
                return FORBIDDEN
            return Answer(b"{}", "application/json", report=request.body)
        if request.method != "GET":
            return NOT_ALLOWED
        if request.path == "/":
            return Answer(self._html, "text/html; charset=utf-8")
        if request.path == "/state.json":
            return Answer(json.dumps(self._state.values()).encode(), "application/json")
        if request.path == "/clock":  # for the browser to compute the offset of its clock
            return Answer(str(time.monotonic()).encode(), "application/json")
        if request.path == "/stream":
            return Answer(b"", "application/octet-stream", report=LOOKING, news=StateNews(self._state))
        if request.path == "/report.html":
            try:
                html = Path(self._state.progress.report).read_bytes()
            except OSError:
                return NOT_FOUND
            return Answer(html, "text/html; charset=utf-8", report=REPORT_SHOWN)
        if request.path.startswith("/past/"):
            name, _, number = request.path.removeprefix("/past/").rpartition("/")
            record = self._state.past(unquote(name), number)
            return NOT_FOUND if record is None else Answer(record, "application/octet-stream")
        name = unquote(request.path.removeprefix("/picture/").removesuffix(".jpg"))
        picture = self._state.picture(name)
        return NOT_FOUND if picture is None or request.path == name else Answer(picture, "image/jpeg")

    def close(self) -> None:
        self._over.set()
        self._reader.join()
        self._inbox.close()

    def _read(self) -> None:
        """Read messages until the page is closed, also if no browser shows it; runs in a separate thread."""
        while not self._over.wait(READ_EVERY_S):
            self._state.read()
