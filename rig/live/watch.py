"""The page of `--watch`: read-only, on threads of its own, so that no browser is ever waited for."""

import ipaddress
import json
import socket
import tempfile
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote, urlsplit

from drivers.errors import InputError
from rig.live.feed import Inbox, Listener
from rig.live.watch_state import WatchState
from rig.pages.page import render
from rig.pages.serving import PageHandler, PageServer

LOOPBACK = "127.0.0.1"


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

    at: host and port. title, what, done, total: as `WatchState`. Raises `InputError` for an address that
    cannot be served.
    """

    def __init__(self, at: tuple[str, int], title: str, what: str, done: int, total: int) -> None:
        self.html = render("rig.live", "watch.html", title=title).encode()
        try:
            self._server = PageServer(at, partial(_Handler, self))
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"--watch-at {at[0]}:{at[1]}: nothing can be served there ({why}); choose another address"
            ) from error
        self._folder = tempfile.TemporaryDirectory(prefix="rig-watch-")
        self._inbox = Inbox(f"{self._folder.name}/page")
        self.listener = Listener(self._inbox.address, pictures=True)
        self.state = WatchState(title, what, done, total, self._inbox.take)
        bound = str(self._server.server_address[0])
        self.loopback = ipaddress.ip_address(bound).is_loopback
        host = socket.gethostname() if ipaddress.ip_address(bound).is_unspecified else at[0]
        self.address = f"http://{host}:{self._server.port}/"
        self._server.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.close()
        self._inbox.close()
        self._folder.cleanup()


class _Handler(PageHandler):
    def __init__(self, page: WatchPage, *connection: Any) -> None:
        self._page = page
        super().__init__(*connection)

    def do_GET(self) -> None:  # noqa: N802 - as http.server calls it
        path = urlsplit(self.path).path
        if not self._asked_here():
            self.answer(HTTPStatus.FORBIDDEN, "text/plain", b"asked under another name")
        elif path == "/":
            self.answer(HTTPStatus.OK, "text/html; charset=utf-8", self._page.html)
        elif path == "/state.json":
            self.answer(HTTPStatus.OK, "application/json", json.dumps(self._page.state.values()).encode())
        else:
            self._picture(path)

    def _picture(self, path: str) -> None:
        name = unquote(path.removeprefix("/picture/").removesuffix(".jpg"))
        picture = self._page.state.picture(name)
        if picture is None or path == name:
            self.answer(HTTPStatus.NOT_FOUND, "text/plain", b"not here")
        else:
            self.answer(HTTPStatus.OK, "image/jpeg", picture)

    def _asked_here(self) -> bool:
        """A site elsewhere whose name leads to this computer's loopback is not to read the page."""
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        return not self._page.loopback or host in ("localhost", LOOPBACK)
