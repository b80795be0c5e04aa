"""A local page's server: on threads of its own, quiet, never waited for by what it shows."""

import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socketserver import TCPServer, ThreadingMixIn
from typing import Any, Self

WAIT_S = 5.0
"""For what a browser sends and takes: a connection that stays silent keeps a thread."""
MOST_AT_ONCE = 16
"""Connections that are answered at a time; a browser opens six."""


class PageHandler(BaseHTTPRequestHandler):
    """Answers one request. What a class of it has no `do_` method for is refused."""

    timeout = WAIT_S

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is the person's."""

    def answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        """Send an answer; a browser that shows something else by now has hung up."""
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        with suppress(ConnectionError):
            self.end_headers()
            self.wfile.write(body)


class PageServer(ThreadingMixIn, TCPServer):
    """Serves from `start` to `close`. Raises `OSError` for an address where it cannot.

    at: host and port, 0 for a free one. handler: makes a `PageHandler` of a connection.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, at: tuple[str, int], handler: Any) -> None:
        self._free = threading.BoundedSemaphore(MOST_AT_ONCE)
        super().__init__(at, handler)
        self.port = int(self.server_address[1])
        self._thread = threading.Thread(target=self.serve_forever, args=(0.05,), daemon=True, name="page")

    def start(self) -> Self:
        """Begin to serve."""
        self._thread.start()
        return self

    def close(self) -> None:
        """Stop serving; connections that are still open are not waited for."""
        self.shutdown()
        self.server_close()
        self._thread.join()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer on a thread, unless so many are at work."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for the next."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a connection that broke."""
