"""The page of `--watch`: read-only, in a process of its own, so that no browser is ever waited for."""

import json
import socket
import tempfile
from dataclasses import asdict
from functools import partial
from ipaddress import ip_address
from urllib.parse import unquote

from drivers.errors import InputError
from rig.live.feed import Inbox, Listener
from rig.live.onlookers import Event
from rig.live.watch_state import Progress, WatchState
from rig.pages.page import render
from rig.pages.process import PageProcess
from rig.pages.serving import LOOPBACK, NOT_ALLOWED, NOT_FOUND, Answer, Request


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
        """Show an event; never waits. Each message holds all that was told before, so one may be lost."""
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
