"""Serve a local page over HTTP, in one thread and at a limited rate; validate each request.

An idle or slow client occupies a socket for at most `WAIT_S`, and no thread. A response with news continues
until its browser disconnects. A page that other computers can reach needs a key, see `Access`.
"""

import asyncio
import os
import select
import socket
from collections.abc import Callable
from typing import Protocol
from urllib.parse import urlsplit

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.errors import RigError
from drivers.realtime import ordinary
from rig.pages.requests import UNREADABLE, Access, Answer, News, Request

WAIT_S = 5.0
"""Longest time from a connection to the end of its response, s."""
MOST_AT_ONCE = 64
"""Most open connections; any further connection replaces the oldest."""
MOST_PER_S, BURST = 100.0, 50
"""Most connections accepted per second on average, and most at once after a pause.

A browser makes about 10 per second. Further connections wait in the kernel, where they need no processor
time.
"""
MOST_HEAD_BYTES = MOST_BODY_BYTES = 16_384
MOST_MESSAGE_BYTES = 200_000
"""Largest message of the program; it must fit into the send buffer of a socket (208 KiB, socket(7))."""
NEWS_EVERY_S = 0.008
"""Period at which news are polled, s: each frame of two sensors at 60 frames per second."""
UNSENT_BYTES = 65_536
"""While more bytes than this are unsent, no further news are sent to a browser."""
RETRY_S = 0.1
GIVE_WAY = 10
"""Niceness of the process (nice(2)): the program gets about 10 times its share of a core."""
STOP_S = 2.0
BACKLOG = 64


class Page(Protocol):
    """The page that a server shows. Its methods are called from one thread and must not block."""

    def answer(self, request: Request) -> Answer: ...

    def take(self, message: bytes) -> None:
        """Process a message of the program."""
        ...

    def close(self) -> None: ...


async def serve(page: Page, listening: socket.socket, program: socket.socket, access: Access) -> None:
    """Serve browsers until the program closes its end of the socket or ends.

    listening: socket for browsers. program: SOCK_SEQPACKET socket, with messages to the page and reports from
    it.
    """
    over = asyncio.Event()
    listening.setblocking(False)
    program.setblocking(False)
    asyncio.get_running_loop().add_reader(program, _hear, page, program, over.set)
    accepting = asyncio.create_task(_accept(page, listening, program, access))
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


async def _accept(page: Page, listening: socket.socket, program: socket.socket, access: Access) -> None:
    loop, pace = asyncio.get_running_loop(), _Pace()
    open_now: dict[asyncio.Task[None], None] = {}
    while True:
        await pace.turn()
        try:
            connection, _ = await loop.sock_accept(listening)
        except OSError:  # no file descriptor is free, or the client has disconnected
            await asyncio.sleep(RETRY_S)
            continue
        if len(open_now) >= MOST_AT_ONCE:
            oldest = next(iter(open_now))
            del open_now[oldest]
            oldest.cancel()
        task = loop.create_task(_converse(page, connection, access, program))
        open_now[task] = None
        task.add_done_callback(lambda done: open_now.pop(done, None))


class _Pace:
    """Rate limiter: `MOST_PER_S` turns per second, after a pause `BURST` turns at once."""

    def __init__(self) -> None:
        self._next_s = 0.0

    async def turn(self) -> None:
        """Wait for the next turn."""
        now_s = asyncio.get_running_loop().time()
        self._next_s = max(self._next_s, now_s - BURST / MOST_PER_S) + 1.0 / MOST_PER_S
        await asyncio.sleep(max(0.0, self._next_s - now_s))


async def _converse(page: Page, connection: socket.socket, access: Access, program: socket.socket) -> None:
    """Read one request and respond; a client that is too slow is disconnected."""
    reader, writer = await asyncio.open_connection(sock=connection, limit=MOST_HEAD_BYTES)
    try:
        async with asyncio.timeout(WAIT_S):
            answer, request = UNREADABLE, await _read(reader)
            if request is not None:
                answer = access.refusal(request) or access.admit(request, page.answer(request))
            writer.write(answer.encode())
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
    """Send news until the browser disconnects, or receives nothing for `WAIT_S`."""
    writer.transport.set_write_buffer_limits(high=UNSENT_BYTES)
    while not writer.transport.is_closing():
        if data := news():
            writer.write(data)
            async with asyncio.timeout(WAIT_S):
                await writer.drain()
        await asyncio.sleep(NEWS_EVERY_S)


async def _read(reader: asyncio.StreamReader) -> Request | None:
    """Read a request; return None if it is invalid."""
    try:
        head = await reader.readuntil(b"\r\n\r\n")
        first, *fields = head[:-4].decode("latin-1").split("\r\n")
        method, target, _ = f"{first}  ".split(" ", 2)
        address = urlsplit(target)
        headers = {name.lower(): value.strip() for name, _, value in (f.partition(":") for f in fields)}
        length = int(headers.get("content-length", "0"))
    except (asyncio.LimitOverrunError, ValueError):
        return None
    if not 0 <= length <= MOST_BODY_BYTES:
        return None
    return Request(method, address.path, headers, await reader.readexactly(length), address.query)


class PageProcess:
    """Serves a page at `host` and `port` in another process until it is closed.

    make: makes the `Page` in that process; must be picklable. at: host and port, 0 for a free port. keyed:
    see `Access.of`. access: who may use the page. Raises `OSError` or `UnicodeError` if the address cannot
    be used.
    """

    def __init__(self, make: Callable[[], Page], at: tuple[str, int], keyed: bool = False) -> None:
        with socket.create_server(at, backlog=BACKLOG) as listening:
            self.host, self.port = listening.getsockname()
            self.access = Access.of(listening, keyed)
            self._program, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._program.setblocking(False)
            with theirs:
                self._process = spawn_context().Process(
                    target=_run, args=(make, listening, theirs, self.access), name="page"
                )
                self._process.start()

    def send(self, message: bytes) -> bool:
        """Send a message without waiting; return whether it was sent."""
        try:
            return self._program.send(message) == len(message)
        except OSError:  # the page is closed or too slow, or its process has ended
            return False

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next report of the page, None if none arrives within the timeout.

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
        """Stop the server without waiting for open connections."""
        self._program.close()
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(make: Callable[[], Page], listening: socket.socket, program: socket.socket, access: Access) -> None:
    leave_signals_to_parent()
    os.nice(GIVE_WAY)
    with ordinary():  # a child process inherits real-time priority
        page = make()
        try:
            asyncio.run(serve(page, listening, program, access))
        finally:
            page.close()
