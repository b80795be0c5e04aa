"""A local page over HTTP: requests are read, checked and answered, all on one thread and at a bounded rate.

An idle or slow client occupies a socket for at most `WAIT_S`, and no thread. An answer with news is sent
until its browser has gone.
"""

import asyncio
import ipaddress
import os
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Protocol
from urllib.parse import urlsplit

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.errors import RigError
from drivers.realtime import ordinary

LOOPBACK = "127.0.0.1"
WAIT_S = 5.0
"""Longest time from a connection to the end of its answer."""
MOST_AT_ONCE = 64
"""Open connections; beyond that a new one replaces the oldest."""
MOST_PER_S, BURST = 100.0, 50
"""Connections accepted per second on average, and at once after a pause. A browser makes about 10 per second.

Further connections wait in the kernel, where they cost no processor time.
"""
MOST_HEAD_BYTES = MOST_BODY_BYTES = 16_384
MOST_MESSAGE_BYTES = 200_000
"""A message of the program has to fit into a socket's send buffer, 208 KiB by default (socket(7))."""
NEWS_EVERY_S = 0.008
"""How often there may be news: at each frame of two sensors at 60 frames per second."""
UNSENT_BYTES = 65_536
"""News wait while more than this is on its way to a browser."""
RETRY_S = 0.1
GIVE_WAY = 10
"""Niceness of the process (nice(2)): the program gets about 10 times its share of a core."""
STOP_S = 2.0
BACKLOG = 64


@dataclass(frozen=True, slots=True)
class Request:
    """A request of a browser. headers: by lower-case name."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes = b""

    def header(self, name: str) -> str:
        """Return a header's value, "" without one."""
        return self.headers.get(name, "")


News = Callable[[], bytes]
"""Returns what a browser has not been sent yet, b"" if there is nothing new. It has to return soon."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request. report: sent to the program once the browser has the answer.

    news: if given, the answer has no end: what it returns follows the body, until the browser or the program
    has gone. A slow browser is sent less often.
    """

    body: bytes
    kind: str = "text/plain"
    status: HTTPStatus = HTTPStatus.OK
    report: bytes = b""
    news: News | None = None

    def packed(self) -> bytes:
        """Return the answer as it is sent."""
        lines = [
            f"HTTP/1.1 {self.status.value} {self.status.phrase}",
            f"Content-Type: {self.kind}",
            *([] if self.news else [f"Content-Length: {len(self.body)}"]),
            "Cache-Control: no-store",
            "X-Content-Type-Options: nosniff",
            "Cross-Origin-Resource-Policy: same-origin",
            "X-Frame-Options: DENY",  # a site elsewhere could lay the page, unseen, under the pointer
            "Connection: close",
        ]
        return "\r\n".join([*lines, "", ""]).encode() + self.body


NOT_FOUND = Answer(b"not here", status=HTTPStatus.NOT_FOUND)
NOT_ALLOWED = Answer(b"not allowed", status=HTTPStatus.METHOD_NOT_ALLOWED)
FORBIDDEN = Answer(b"asked under another name, or from another site", status=HTTPStatus.FORBIDDEN)
UNREADABLE = Answer(b"not understood", status=HTTPStatus.BAD_REQUEST)


class Page(Protocol):
    """What a server shows. It is called from one thread, and has to return soon."""

    def answer(self, request: Request) -> Answer:
        """Answer a request."""
        ...

    def take(self, message: bytes) -> None:
        """Take a message of the program."""
        ...

    def close(self) -> None:
        """Release what the page holds."""
        ...


async def serve(page: Page, listening: socket.socket, program: socket.socket) -> None:
    """Answer browsers until the program closes its end of the socket, or has ended.

    listening: accepts browsers. program: SOCK_SEQPACKET, messages for the page, and reports in return.
    """
    over = asyncio.Event()
    listening.setblocking(False)
    program.setblocking(False)
    asyncio.get_running_loop().add_reader(program, _hear, page, program, over.set)
    accepting = asyncio.create_task(_accept(page, listening, program))
    await over.wait()
    accepting.cancel()


def _hear(page: Page, program: socket.socket, end: Callable[[], None]) -> None:
    try:
        message = program.recv(MOST_MESSAGE_BYTES)
    except OSError:
        message = b""
    if message:
        page.take(message)
    else:
        end()


async def _accept(page: Page, listening: socket.socket, program: socket.socket) -> None:
    loop, pace = asyncio.get_running_loop(), _Pace()
    open_now: dict[asyncio.Task[None], None] = {}
    while True:
        await pace.turn()
        try:
            connection, _ = await loop.sock_accept(listening)
        except OSError:  # no descriptor is free, or the client has gone
            await asyncio.sleep(RETRY_S)
            continue
        if len(open_now) >= MOST_AT_ONCE:
            oldest = next(iter(open_now))
            del open_now[oldest]
            oldest.cancel()
        task = loop.create_task(_converse(page, connection, _names(listening), program))
        open_now[task] = None
        task.add_done_callback(lambda done: open_now.pop(done, None))


class _Pace:
    """Spaces turns 1 / `MOST_PER_S` apart, `BURST` of them less."""

    def __init__(self) -> None:
        self._next_s = 0.0

    async def turn(self) -> None:
        """Wait for the next turn."""
        now_s = asyncio.get_running_loop().time()
        self._next_s = max(self._next_s, now_s - BURST / MOST_PER_S) + 1.0 / MOST_PER_S
        await asyncio.sleep(max(0.0, self._next_s - now_s))


async def _converse(
    page: Page, connection: socket.socket, names: frozenset[str], program: socket.socket
) -> None:
    """Read one request and answer it; a client that is too slow or gone is disconnected."""
    reader, writer = await asyncio.open_connection(sock=connection, limit=MOST_HEAD_BYTES)
    try:
        async with asyncio.timeout(WAIT_S):
            answer = _answer(page, await _read(reader), names)
            writer.write(answer.packed())
            if answer.news is None:
                writer.close()
                await writer.wait_closed()
        if answer.report:
            program.send(answer.report)
        if answer.news is not None:
            await _keep_sending(writer, answer.news)
    except (TimeoutError, OSError, EOFError):
        pass
    finally:
        writer.transport.abort()


async def _keep_sending(writer: asyncio.StreamWriter, news: News) -> None:
    """Send news until the browser has gone, or takes none for `WAIT_S`."""
    writer.transport.set_write_buffer_limits(high=UNSENT_BYTES)
    while not writer.transport.is_closing():
        if data := news():
            writer.write(data)
            async with asyncio.timeout(WAIT_S):
                await writer.drain()
        await asyncio.sleep(NEWS_EVERY_S)


def _answer(page: Page, request: Request | None, names: frozenset[str]) -> Answer:
    if request is None:
        return UNREADABLE
    return page.answer(request) if is_from_here(request, names) else FORBIDDEN


def is_from_here(request: Request, names: frozenset[str]) -> bool:
    """Whether a request asks for this computer's page, and comes from that page or from a person.

    names: hosts under which the page may be asked for; empty for all, but changes need a host that
    `is_this_computer`. A site elsewhere can lead its own name to this computer's address, which shows in
    Host, and can send requests here, which shows in Origin.
    """
    try:
        host = urlsplit(f"//{request.header('host')}").hostname or ""
    except ValueError:
        return False
    known = host in names if names else request.method == "GET" or is_this_computer(host)
    return known and request.header("origin") in ("", f"http://{request.header('host')}")


def is_this_computer(host: str) -> bool:
    """Whether a host is an IP address or this computer's own name: no site elsewhere has either."""
    name = socket.gethostname().lower()
    if host in ("localhost", name, f"{name}.local"):
        return True
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _names(listening: socket.socket) -> frozenset[str]:
    """Return the hosts under which a page on the loopback may be asked for; empty if others may look on."""
    address = str(listening.getsockname()[0])
    loopback = ipaddress.ip_address(address).is_loopback
    return frozenset({"localhost", LOOPBACK, address}) if loopback else frozenset()


async def _read(reader: asyncio.StreamReader) -> Request | None:
    """Read a request; None for anything else."""
    try:
        head = await reader.readuntil(b"\r\n\r\n")
        first, *fields = head[:-4].decode("latin-1").split("\r\n")
        method, target, _ = f"{first}  ".split(" ", 2)
        path = urlsplit(target).path
        headers = {name.lower(): value.strip() for name, _, value in (f.partition(":") for f in fields)}
        length = int(headers.get("content-length", "0"))
    except (asyncio.LimitOverrunError, ValueError):
        return None
    if not 0 <= length <= MOST_BODY_BYTES:
        return None
    return Request(method, path, headers, await reader.readexactly(length))


class PageProcess:
    """Serves a page at `host` and `port` until it is closed.

    make: makes the `Page`, in that process; has to be picklable. at: host and port, 0 for a free one. Raises
    `OSError` or `UnicodeError` for an address where nothing can be served.
    """

    def __init__(self, make: Callable[[], Page], at: tuple[str, int]) -> None:
        with socket.create_server(at, backlog=BACKLOG) as listening:
            self.host, self.port = listening.getsockname()
            self._program, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._program.setblocking(False)
            with theirs:
                self._process = spawn_context().Process(
                    target=_run, args=(make, listening, theirs), name="page"
                )
                self._process.start()

    def send(self, message: bytes) -> bool:
        """Send a message without waiting; return whether the page will get it."""
        try:
            return self._program.send(message) == len(message)
        except OSError:  # the page is stopped or too slow, or its process has ended
            return False

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next report of the page, None if there is none in time.

        Raises `RigError` if the page's process has ended.
        """
        if not select.select([self._program], [], [], timeout_s)[0]:
            return None
        try:
            report = self._program.recv(MOST_MESSAGE_BYTES)
        except OSError:
            report = b""
        if not report:
            raise RigError("the process that serves the page has ended; start the command again")
        return report

    def close(self) -> None:
        """Stop serving; open connections are not waited for."""
        self._program.close()
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(make: Callable[[], Page], listening: socket.socket, program: socket.socket) -> None:
    leave_signals_to_parent()
    os.nice(GIVE_WAY)
    with ordinary():  # a program at real-time priority hands its priority on
        page = make()
        try:
            asyncio.run(serve(page, listening, program))
        finally:
            page.close()
