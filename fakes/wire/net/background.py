"""Threads that a fake cannot do without, and a socket server in one of them."""

import logging
import socketserver
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)


class VitalThread(threading.Thread):
    """A thread whose end is its fake's end. failure: what ended it, None where nothing did.

    Whoever started the fake looks at `failure` and ends the process; a fake that only goes on
    pretending is worse than none.
    """

    def __init__(self, work: Callable[[], None], name: str) -> None:
        super().__init__(name=name, daemon=True)
        self._work = work
        self.failure: Exception | None = None

    def run(self) -> None:
        """Work, and note what went wrong."""
        try:
            self._work()
        except Exception as error:
            _log.exception("%s has ended", self.name)
            self.failure = error


class BackgroundServer:
    """Serves from `start` to `stop`. poll_s: how soon it notices that it is to stop."""

    def __init__(self, server: socketserver.TCPServer, poll_s: float = 0.1) -> None:
        self._server = server
        self._thread = VitalThread(lambda: server.serve_forever(poll_s), type(self).__name__)

    @property
    def host_port(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._server.server_address[:2]
        return str(host), int(port)

    @property
    def failure(self) -> Exception | None:
        """What ended it by itself; None where nothing did."""
        return self._thread.failure

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Stop listening. Safe before `start`."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()
