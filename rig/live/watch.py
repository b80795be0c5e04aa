"""The page of `--watch` and of `rig live`, in a process of its own, so that no browser is ever waited for.

The page of `--watch` is read-only. That of `rig live` also passes on what a person asks for by its buttons.
"""

import json
import secrets
import socket
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import unquote

from drivers.errors import InputError, RigError
from rig.live.feed import Inbox, Listener
from rig.live.onlookers import Event
from rig.live.watch_state import Progress, StateNews, WatchState
from rig.pages.page import render
from rig.pages.serving import (
    FORBIDDEN,
    LOOPBACK,
    NOT_ALLOWED,
    NOT_FOUND,
    Answer,
    PageProcess,
    Request,
)

TOKEN = "x-rig-token"  # noqa: S105 - its name
"""Header of a request that changes something, with the token that only the page itself knows."""
MOST_ACTION_BYTES = 200
REPORT_WAIT_S = 1.5
"""A browser that looks on is given this much time to fetch the report before the page ends."""
LOOKING, REPORT_SHOWN = b"looking", b"report shown"
"""What the page's process reports: a browser has opened the page, and a browser has the report."""


def watch_address(at: str | None, option: str = "--watch-at", port: int = 0) -> tuple[str, int]:
    """Return host and port to serve at; port 0 is a free one.

    at: as typed for the option, HOST:PORT, None for `port` on this computer alone. Raises `InputError` for
    anything else.
    """
    if at is None:
        return LOOPBACK, port
    host, _, typed = at.rpartition(":")
    if not host or not (typed.isascii() and typed.isdecimal()) or len(typed) > 5 or int(typed) > 65535:
        raise InputError(f"{option} {at}: write host and port, as {LOOPBACK}:{port or 8080}")
    return host, int(typed)


class WatchPage:
    """Serves what happens at `address` until it is closed. `listener`: lifts and poses send to it.

    at: host and port. title, what, done, total: as `Progress`. estimators: names to choose from on a page
    with buttons, see `asked`; a page without them is read-only. Raises `InputError` for an address that
    cannot be served.
    """

    def __init__(
        self,
        at: tuple[str, int],
        title: str,
        what: str = "",
        done: int = 0,
        total: int = 0,
        estimators: Sequence[str] = (),
    ) -> None:
        self._progress = Progress(title, what, done, total)
        self._folder = tempfile.TemporaryDirectory(prefix="rig-watch-")
        self.listener = Listener(f"{self._folder.name}/page", pictures=True)
        try:
            made = partial(Watched, self._progress, self.listener.address, tuple(estimators))
            self.process = PageProcess(made, at)
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

    def show_report(self, file: Path) -> None:
        """Let browsers that look on show a report from now on; it is one file."""
        self._progress = replace(self._progress, report=str(file.absolute()))
        self.process.send(json.dumps(asdict(self._progress)).encode())

    def asked(self) -> str | None:
        """Return the action of a pressed button, None if there is none; never blocks. Raises `RigError`."""
        report = self.process.receive(0.0)
        return None if report in (None, LOOKING) else str(report, errors="replace")

    def close(self) -> None:
        """Stop serving, once a browser that looks on has the report, if there is one."""
        if self._progress.report:
            with suppress(RigError):
                self._wait_until_shown()
        self.process.close()
        self._folder.cleanup()

    def _wait_until_shown(self) -> None:
        """Wait until a browser that looks on has the report; not at all if none does. Raises `RigError`."""
        looking = False
        while report := self.process.receive(REPORT_WAIT_S if looking else 0.0):
            if report == REPORT_SHOWN:
                return
            looking = True


class Watched:
    """The page, in its own process.

    progress: of the command so far. address: lifts, poses and sensors send there. estimators: as `WatchPage`.
    """

    def __init__(self, progress: Progress, address: str, estimators: tuple[str, ...] = ()) -> None:
        self._acting, self._token = bool(estimators), secrets.token_urlsafe(16)
        self._html = render(
            "rig.live", "watch.html", title=progress.title, estimators=estimators, token=self._token
        ).encode()
        self._inbox = Inbox(address)
        self._state = WatchState(progress, self._inbox.take)

    def take(self, message: bytes) -> None:
        """Take the command's progress."""
        self._state.progress = Progress(**json.loads(message))

    def answer(self, request: Request) -> Answer:
        """Answer a request."""
        if request.method == "POST" and request.path == "/do" and self._acting:
            return self._passed_on(request)
        if request.method != "GET":
            return NOT_ALLOWED
        if request.path == "/":
            return Answer(self._html, "text/html; charset=utf-8")
        if request.path == "/state.json":
            return Answer(json.dumps(self._state.values()).encode(), "application/json")
        if request.path == "/clock":  # a browser finds the offset of its own clock by this
            return Answer(str(time.monotonic()).encode(), "application/json")
        if request.path == "/stream":
            return Answer(b"", "application/octet-stream", report=LOOKING, news=StateNews(self._state))
        if request.path == "/report.html":
            return self._report()
        return self._picture(request.path)

    def close(self) -> None:
        """Stop receiving."""
        self._inbox.close()

    def _passed_on(self, request: Request) -> Answer:
        """Pass on what a person asked for by a button, as text."""
        known = secrets.compare_digest(request.header(TOKEN).encode(), self._token.encode())
        if not known or not 0 < len(request.body) <= MOST_ACTION_BYTES:
            return FORBIDDEN
        return Answer(b"{}", "application/json", report=request.body)

    def _report(self) -> Answer:
        try:
            html = Path(self._state.progress.report).read_bytes()
        except OSError:
            return NOT_FOUND
        return Answer(html, "text/html; charset=utf-8", report=REPORT_SHOWN)

    def _picture(self, path: str) -> Answer:
        name = unquote(path.removeprefix("/picture/").removesuffix(".jpg"))
        picture = self._state.picture(name)
        return NOT_FOUND if picture is None or path == name else Answer(picture, "image/jpeg")
