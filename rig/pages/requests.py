"""Requests of browsers, the answers to them, and who may use a page."""

import ipaddress
import secrets
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Request:
    """A request of a browser. headers: by lower-case name. query: what follows the "?" of the address."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes = b""
    query: str = ""

    def header(self, name: str) -> str:
        """Return a header's value, "" without one."""
        return self.headers.get(name, "")


News = Callable[[], bytes]
"""Returns the data that a browser has not received yet, b"" if there is nothing new. It must not block."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The response to a request. report: sent to the program after the browser has received the response.

    news: if given, its data follow the body until the browser disconnects or the program ends. A slow browser
    gets news less often. cookie: stored by the browser; "" for none.
    """

    body: bytes
    kind: str = "text/plain"
    status: HTTPStatus = HTTPStatus.OK
    report: bytes = b""
    news: News | None = None
    cookie: str = ""

    def encode(self) -> bytes:
        lines = [
            f"HTTP/1.1 {self.status.value} {self.status.phrase}",
            f"Content-Type: {self.kind}",
            *([] if self.news else [f"Content-Length: {len(self.body)}"]),
            *([f"Set-Cookie: {self.cookie}; HttpOnly; SameSite=Strict"] if self.cookie else []),
            "Cache-Control: no-store",
            "X-Content-Type-Options: nosniff",
            "Cross-Origin-Resource-Policy: same-origin",
            "X-Frame-Options: DENY",  # against clickjacking by another site
            "Referrer-Policy: same-origin",  # another site must not learn the key in the address
            "Connection: close",
        ]
        return "\r\n".join([*lines, "", ""]).encode() + self.body


NOT_FOUND = Answer(b"not found", status=HTTPStatus.NOT_FOUND)
NOT_ALLOWED = Answer(b"method not allowed", status=HTTPStatus.METHOD_NOT_ALLOWED)
FORBIDDEN = Answer(b"request to another host name, or from another site", status=HTTPStatus.FORBIDDEN)
NEEDS_KEY = Answer(
    b"this page needs its key: open the address that the command printed at its terminal",
    status=HTTPStatus.FORBIDDEN,
)
UNREADABLE = Answer(b"invalid request", status=HTTPStatus.BAD_REQUEST)


@dataclass(frozen=True, slots=True)
class Access:
    """Who may use a page.

    names: host names under which the page is requested; empty for all. key: secret that each request must
    contain, in the query of the address or in the cookie that this address sets; "" if everybody at this
    computer may use the page. port: of the page; cookies of pages at other ports of a host have other names.
    """

    names: frozenset[str]
    key: str
    port: int

    @classmethod
    def of(cls, listening: socket.socket, keyed: bool = False) -> "Access":
        """Return who may use the page at a socket.

        keyed: whether a page that only this computer can reach has a key, too, against other users of it. A
        page that other computers can reach always has one.
        """
        address, port = listening.getsockname()
        local = ipaddress.ip_address(address).is_loopback
        key = secrets.token_urlsafe(16) if keyed or not local else ""
        return cls(frozenset({"localhost", LOOPBACK, address} if local else ()), key, port)

    @property
    def query(self) -> str:
        """The query of an address with the key, "" without a key."""
        return self.key and f"key={self.key}"

    def refusal(self, request: Request) -> Answer | None:
        """Return the refusal of a request, None if it is allowed.

        Another site can resolve its own name to the address of this computer, which the header Host shows, or
        the missing cookie. It can send requests to it, which the header Origin shows.
        """
        try:
            host = urlsplit(f"//{request.header('host')}").hostname or ""
        except ValueError:
            return FORBIDDEN
        known = host in self.names or not self.names
        if not known or request.header("origin") not in ("", f"http://{request.header('host')}"):
            return FORBIDDEN
        shown = [request.query, *request.header("cookie").split(";")]
        return None if not self.key or any(map(self._has_key, shown)) else NEEDS_KEY

    def admit(self, request: Request, answer: Answer) -> Answer:
        """Return the answer to an allowed request, with a cookie if the key was in the address."""
        cookie = f"rig-{self.port}-{self.query}"
        return replace(answer, cookie=cookie) if self.key and self._has_key(request.query) else answer

    def _has_key(self, text: str) -> bool:
        """Whether a query or a cookie contains the key."""
        shown = text.strip().removeprefix(f"rig-{self.port}-").encode()
        return secrets.compare_digest(shown, self.query.encode())


@contextmanager
def way_to(address: str) -> Iterator[str]:
    """Give the address of a file that redirects a browser to `address`; only this user can read the file.

    Otherwise `ps` would show the secret in the address to every user of the computer.
    """
    with tempfile.TemporaryDirectory(prefix="rig-page-") as folder:  # made with mode 0700
        file = Path(folder) / "page.html"
        file.touch(mode=0o600)
        file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">')
        yield file.as_uri()
