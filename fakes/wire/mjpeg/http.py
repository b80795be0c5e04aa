"""The HTTP side of a served sensor: the stream, and the paths beside it."""

import json
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from drivers.errors import InputError
from fakes.wire.mjpeg.sensor import Capture, MjpegSensor
from fakes.wire.net.background import BackgroundServer

BOUNDARY = "frame"
LONGEST_BODY = 65_536
STUCK_S = 5.0
"""A client that reads nothing for this long is dropped."""
_PAGE = b'<!doctype html><title>simulated sensor</title><img src="/stream.mjpg" alt="stream">'


class Served(Protocol):
    """What the HTTP side needs of the server it belongs to."""

    @property
    def sensor(self) -> MjpegSensor:
        """Takes settings and faults."""
        ...

    def captures(self) -> Iterator[Capture]:
        """Join the stream."""
        ...

    def headers_of(self, capture: Capture) -> dict[str, str]:
        """Headers of an image."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """Counts."""
        ...


class HttpSide(BackgroundServer):
    """Listens on a port; each connection has a thread."""

    def __init__(self, host: str, port: int, served: Served) -> None:
        handler = type("Handler", (_Handler,), {"served": served})
        super().__init__(_Server((host, port), handler), poll_s=0.05)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is no event."""


class _Handler(BaseHTTPRequestHandler):
    served: Served
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = STUCK_S

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if self.served.sensor.active("disconnect"):
            self.close_connection = True  # as a device that is gone: no answer at all
        elif path == "/stream.mjpg":
            self._stream()
        elif path == "/snapshot.jpg":
            self._one_image()
        elif path == "/status":
            self._answer(HTTPStatus.OK, "application/json", json.dumps(self.served.snapshot()).encode())
        elif path == "/":
            self._answer(HTTPStatus.OK, "text/html", _PAGE)
        else:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"see /stream.mjpg, /snapshot.jpg, /status\n")

    def do_HEAD(self) -> None:
        self._begin_stream()

    def do_POST(self) -> None:
        try:
            request = self._json()
            if self.path == "/control":
                answer: Mapping[str, Any] = self.served.sensor.configure(request)
            elif self.path == "/fault":
                answer = self._fault(request)
            else:
                raise InputError("settings go to /control, faults to /fault")
        except InputError as error:
            self._answer(HTTPStatus.BAD_REQUEST, "text/plain", f"{error}\n".encode())
        else:
            self._answer(HTTPStatus.OK, "application/json", json.dumps(answer).encode())

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: requests are counted in /status."""

    def _json(self) -> dict[str, Any]:
        try:
            length = int(self.headers.get("Content-Length", "0"))
            request = json.loads(self.rfile.read(min(length, LONGEST_BODY)))
        except ValueError as error:
            raise InputError(f"expected a JSON object ({error})") from error
        if not isinstance(request, dict):
            raise InputError("expected a JSON object")
        return request

    def _fault(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            self.served.sensor.inject(**request)
        except TypeError as error:
            raise InputError(f"a fault has kind, duration_s, frames ({error})") from error
        return {}

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _one_image(self) -> None:
        for capture in self.served.captures():
            self._answer(HTTPStatus.OK, "image/jpeg", capture.jpeg)
            return

    def _begin_stream(self) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.send_header("X-Control", "/control")
        self.end_headers()

    def _stream(self) -> None:
        self._begin_stream()
        self.wfile.write(f"--{BOUNDARY}\r\n".encode())
        for capture in self.served.captures():
            head = "".join(f"{name}: {value}\r\n" for name, value in self.served.headers_of(capture).items())
            # the next delimiter goes with the image: browsers show an image when it has come
            self.wfile.write(head.encode() + b"\r\n" + capture.jpeg + f"\r\n--{BOUNDARY}\r\n".encode())
