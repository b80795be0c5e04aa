"""Serves a simulated DIGIT or camera as Motion JPEG over HTTP.

    GET  /stream.mjpg    the images; any MJPEG client can read them (OpenCV, curl, a browser)
    POST /control        {"size_px": [320, 240]}, {"rate_hz": 60}, {"light": [1, 1, 1]}

Each part carries its number (X-Sequence) and its capture time (X-Timestamp, s of the computer's monotonic
clock), so that served and recorded images can be compared.
"""

import json
import threading
from collections import deque
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any
from zlib import crc32

from drivers.clock import NS_PER_S, Clock, SystemClock, slowness_of, to_ns
from drivers.errors import InputError
from fakes.wire.mjpeg.sensor import Capture, Kind, MjpegSensor, OnLight, Render
from fakes.wire.net import BackgroundServer, QuietServer, VitalThread

LATENCY_S = 0.004
"""From capture to rendering: by then the world has advanced to the time of the image."""
PATIENCE_S = 0.25
"""Images that cannot be rendered within this time are discarded and counted as missed."""
QUEUE = 32
POLL_S = 0.1
BOUNDARY = "frame"
LONGEST_BODY = 65_536
STUCK_S = 5.0
"""A client that reads nothing for this long is dropped."""


class MjpegServer:
    """One sensor behind one port. `start` and `stop` it; `url` is its stream.

    render: draws the (H, W, 3) uint8 RGB image at a time in ns of `clock`, upright. It runs in the server's
    thread, and only while a client is connected. kind: "digit" (raw images are rotated by 90 degrees,
    320 x 240 at 60 or 30 Hz, 640 x 480 at 30 or 15) or "camera". phase: when the
    sensor captures within its period, 0 to 1; None derives it from the serial.
    """

    def __init__(
        self,
        serial: str,
        render: Render,
        rate_hz: float,
        clock: Clock,
        host: str = "127.0.0.1",
        kind: Kind = "digit",
        on_light: OnLight | None = None,
        phase: float | None = None,
    ) -> None:
        self.serial = serial
        phase = crc32(serial.encode()) % 1000 / 1000.0 if phase is None else phase
        self.sensor = MjpegSensor(render, rate_hz, clock, kind, on_light, phase)
        self._clock = clock
        self._to_monotonic_ns = SystemClock(slowness_of(clock)).now_ns() - clock.now_ns()
        handler = type("Handler", (_Handler,), {"served": self})
        self._http = BackgroundServer(_Server((host, 0), handler), poll_s=0.05)
        self._changed = threading.Condition()
        self._clients: list[deque[Capture]] = []
        self._stopping = threading.Event()
        self._thread = VitalThread(self._work, f"stream of {serial}")
        self._counts = {"served": 0, "missed": 0, "withheld": 0, "skipped": 0}
        self._ranges: list[list[int]] = []

    @property
    def url(self) -> str:
        host, port = self._http.host_port
        return f"http://{host}:{port}/stream.mjpg"

    @property
    def failure(self) -> Exception | None:
        """The error that ended the stream, None if there was none."""
        return self._thread.failure or self._http.failure

    def start(self) -> None:
        """Start to serve; return at once."""
        self._http.start()
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._http.stop()
        if self._thread.is_alive():
            self._thread.join()

    def inject(self, kind: str, **args: Any) -> None:
        self.sensor.inject(kind, **args)

    def snapshot(self) -> dict[str, Any]:
        """Return the counts since the start.

        served: images sent to clients; ranges: [first, last] of each unbroken run of their numbers; missed:
        images not rendered in time; withheld: images lost by the fault "drop"; skipped: images lost by
        clients that read too slowly; clients: connected now.
        """
        with self._changed:
            ranges = [list(run) for run in self._ranges]
            return {
                "serial": self.serial,
                **self._counts,
                "first": ranges[0][0] if ranges else None,
                "last": ranges[-1][1] if ranges else None,
                "ranges": ranges,
                "clients": len(self._clients),
            }

    def captures(self) -> Iterator[Capture]:
        """Join the stream: yield its captures from now on, until it stops or is disconnected."""
        queue: deque[Capture] = deque()
        with self._changed:
            if not self._clients:
                self.sensor.open()
            self._clients.append(queue)
            self._changed.notify_all()
        try:
            while (capture := self._next(queue)) is not None:
                yield capture
        finally:
            with self._changed:
                self._clients = [other for other in self._clients if other is not queue]

    def part_of(self, capture: Capture) -> bytes:
        """Return an image as a part of the stream, with its headers and the boundary after it."""
        time_ns = capture.time_ns + self._to_monotonic_ns
        head = (
            f"Content-Type: image/jpeg\r\nContent-Length: {len(capture.jpeg)}\r\n"
            f"X-Sequence: {capture.number}\r\n"
            f"X-Timestamp: {time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}\r\n\r\n"
        )
        # the boundary goes with the image: browsers show an image when the boundary has come
        return head.encode() + capture.jpeg + f"\r\n--{BOUNDARY}\r\n".encode()

    def _next(self, queue: deque[Capture]) -> Capture | None:
        with self._changed:
            while not (self._stopping.is_set() or self.sensor.active("disconnect")):
                if queue:
                    return queue.popleft()
                self._changed.wait(POLL_S)
            return None

    def _work(self) -> None:
        while not self._stopping.is_set():
            with self._changed:
                if not self._clients:
                    self._changed.wait(POLL_S)
                    continue
            self._capture_next()

    def _capture_next(self) -> None:
        due_ns, missed = self.sensor.due_ns(to_ns(PATIENCE_S))
        self._clock.sleep_until(due_ns + to_ns(LATENCY_S))
        capture = self.sensor.capture()
        with self._changed:
            self._counts["missed"] += missed
            if capture is None:
                self._counts["withheld"] += 1
            else:
                self._publish(capture)

    def _publish(self, capture: Capture) -> None:
        self._counts["served"] += 1
        if self._ranges and self._ranges[-1][1] == capture.number - 1:
            self._ranges[-1][1] = capture.number
        else:
            self._ranges.append([capture.number, capture.number])
        for queue in self._clients:
            if len(queue) >= QUEUE:
                queue.popleft()
                self._counts["skipped"] += 1
            queue.append(capture)
        self._changed.notify_all()


class _Server(QuietServer, HTTPServer):
    """The HTTP server of a stream."""


class _Handler(BaseHTTPRequestHandler):
    served: MjpegServer
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = STUCK_S

    def do_GET(self) -> None:
        if self.served.sensor.active("disconnect"):
            self.close_connection = True  # like a device that is unplugged: no answer at all
        elif self.path.partition("?")[0] == "/stream.mjpg":
            self._stream()
        else:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"see /stream.mjpg\n")

    def do_POST(self) -> None:
        try:
            if self.path != "/control":
                raise InputError("settings go to /control")
            answer = self.served.sensor.configure(self._json())
        except InputError as error:
            self._answer(HTTPStatus.BAD_REQUEST, "text/plain", f"{error}\n".encode())
        else:
            self._answer(HTTPStatus.OK, "application/json", json.dumps(answer).encode())

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""

    def _json(self) -> dict[str, Any]:
        try:
            length = int(self.headers.get("Content-Length", "0"))
            request = json.loads(self.rfile.read(min(length, LONGEST_BODY)))
        except ValueError as error:
            raise InputError(f"expected a JSON object ({error})") from error
        if not isinstance(request, dict):
            raise InputError("expected a JSON object")
        return request

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.send_header("X-Control", "/control")
        self.end_headers()
        self.wfile.write(f"--{BOUNDARY}\r\n".encode())
        for capture in self.served.captures():
            self.wfile.write(self.served.part_of(capture))
