"""Serve a page in a process of its own, so that no browser takes time from the program that shows it.

The program sends messages and never waits for them: while the page's process is stopped, slow or gone, they
are lost. The process runs at lower priority and ends with the program.
"""

import asyncio
import os
import select
import socket
from collections.abc import Callable

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.errors import RigError
from drivers.realtime import ordinary
from rig.pages.serving import MOST_MESSAGE_BYTES, Page, serve

GIVE_WAY = 10
"""Niceness of the process (nice(2)): the program gets about 10 times its share of a core."""
STOP_S = 2.0
BACKLOG = 64


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
