"""Serves a simulated DIGIT or camera as Motion JPEG over HTTP.

    GET  /stream.mjpg    the images; any MJPEG client can read them (OpenCV, curl, a browser)
    POST /control        {"size_px": [320, 240]}, {"rate_hz": 60}, {"light": [1, 1, 1]}

It replaces the device and its driver in the kernel: raw images on a schedule, each with its number
(X-Sequence) and its capture time (X-Timestamp, s of the computer's monotonic clock), so that served and
recorded images can be compared. Those of a DIGIT are rotated by 90 degrees, and its first ones are green.
"""

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, Literal
from zlib import crc32

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock, SystemClock, slowness_of, to_ns
from drivers.errors import InputError
from drivers.types import Image
from fakes.faults import Faults
from fakes.gel.variation import encode_jpeg
from fakes.wire.net import BackgroundServer, Part, QuietServer

Kind = Literal["digit", "camera"]
Render = Callable[[int], Image]
OnLight = Callable[[float, float, float], None]

FAULTS = {
    kind: {"frames": None} for kind in ("freeze", "drop", "disconnect", "green", "shift", "truncate", "slow")
}
"""Kinds of fault; each takes the number of images after which it ends."""
DIGIT_MODES = {(320, 240): (30.0, 60.0), (640, 480): (15.0, 30.0)}
"""Rates in Hz by raw size in px; a change of size resets the rate to the first."""
GREEN_AFTER_OPENING = 3
JPEG_QUALITY = 95
_EMPTY_BUFFER_RGB = (0, 135, 0)
"""The colour that a YUV buffer of zeros decodes to (ITU-R BT.601)."""
_SHIFT_PX = 37
_CUT_AT = 0.6
_SLOWER = 2


@dataclass(frozen=True, slots=True)
class Capture:
    """One image on the wire. time_ns: capture time on the sensor's clock."""

    number: int
    time_ns: int
    jpeg: bytes


class MjpegSensor:
    """The state of one sensor. `render(time_ns)` draws (H, W, 3) uint8 RGB, upright.

    rate_hz: the initial rate. on_light: is called with the intensities of the LEDs, 0 to 1. phase: time of
    the capture within a period, 0 to 1, so that sensors do not all capture at once. Several threads may use a
    sensor. Raises `InputError` for a rate that a DIGIT does not have.
    """

    def __init__(
        self,
        render: Render,
        rate_hz: float,
        clock: Clock,
        kind: Kind,
        on_light: OnLight | None = None,
        phase: float = 0.0,
    ) -> None:
        self._render, self._clock = render, clock
        self._kind: Kind = kind
        self._on_light, self._phase = on_light, phase
        self._lock = threading.RLock()
        height, width = render(clock.now_ns()).shape[:2]
        self._size = (height, width) if kind == "digit" else (width, height)
        self._rates = DIGIT_MODES if kind == "digit" else {self._size: (rate_hz,)}
        self._rate_hz = rate_hz
        self.faults = Faults("simulated sensor", FAULTS, clock.now_ns)
        self._last: bytes | None = None
        self._greens = 0
        self._number, self._due_ns = 0, clock.now_ns()
        self._set_rate(rate_hz)

    def open(self) -> None:
        """Start the device for the first client, with empty images at first."""
        with self._lock:
            self._skip_until(self._clock.now_ns())
            self._greens = GREEN_AFTER_OPENING if self._kind == "digit" else 0

    def configure(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Set `size_px` [w, h] (raw), `rate_hz`, `light` [r, g, b]; return the present settings.

        Raises `InputError` for a setting that the device does not offer.
        """
        unknown = set(settings) - {"size_px", "rate_hz", "light"}
        if unknown:
            raise InputError(f"sensor: no settings {sorted(unknown)}; there are size_px, rate_hz, light")
        with self._lock:
            if "size_px" in settings:
                size = _numbers(settings["size_px"], 2)
                if size not in self._rates:
                    raise InputError(f"sensor: no size {size}; there are {sorted(self._rates)}")
                self._size = int(size[0]), int(size[1])
                self._set_rate(self._rates[self._size][0])
            if "rate_hz" in settings:
                self._set_rate(_numbers([settings["rate_hz"]], 1)[0])
            if "light" in settings:
                light = _numbers(settings["light"], 3)
                if not all(0.0 <= value <= 1.0 for value in light):
                    raise InputError(f"sensor: light {light}: give each colour from 0 to 1")
                if self._on_light is not None:
                    self._on_light(light[0], light[1], light[2])
            return {"size_px": list(self._size), "rate_hz": self._rate_hz}

    def active(self, kind: str) -> bool:
        fault = self.faults.get(kind)
        return fault is not None and fault["frames"] != 0

    def due_ns(self, patience_ns: int) -> tuple[int, int]:
        """Return the capture time of the next image, and how many were discarded before it.

        If an image has not been captured for `patience_ns`, it is discarded with all that were due since, so
        that the next one is fresh.
        """
        with self._lock:
            now = self._clock.now_ns()
            missed = self._skip_until(now) if now - self._due_ns > patience_ns else 0
            return self._due_ns, missed

    def capture(self) -> Capture | None:
        """Capture the image that is due; return None if it never reaches the wire."""
        with self._lock:
            number, time_ns, size = self._number, self._due_ns, self._size
            self._number += 1
            slower = _SLOWER if self._hits("slow") else 1
            self._due_ns += slower * round(NS_PER_S / self._rate_hz)
            if self._hits("drop"):
                return None
            frozen = self._last if self._hits("freeze") else None
            empty = self._hits("green") or self._greens > 0
            self._greens = max(self._greens - 1, 0)
            shift, cut = self._hits("shift"), self._hits("truncate")
        if frozen is None:
            if empty:
                image = np.full((size[1], size[0], 3), _EMPTY_BUFFER_RGB, np.uint8)
            else:
                image = self._raw(time_ns, size, shift)
            frozen = self._last = encode_jpeg(image, JPEG_QUALITY)
        return Capture(number, time_ns, frozen[: int(len(frozen) * _CUT_AT)] if cut else frozen)

    def _skip_until(self, time_ns: int) -> int:
        """Skip the images up to a time; return how many they were."""
        period_ns = round(NS_PER_S / self._rate_hz)
        passed = max(-((self._due_ns - time_ns) // period_ns), 0)
        self._number += passed
        self._due_ns += passed * period_ns
        return passed

    def _hits(self, kind: str) -> bool:
        """Whether a fault is active for this image; count the image."""
        active, fault = self.active(kind), self.faults.get(kind)
        if active and fault and fault["frames"] is not None:
            fault["frames"] -= 1
        return active

    def _raw(self, time_ns: int, size: tuple[int, int], shift: bool) -> Image:
        image = self._render(time_ns)
        if self._kind == "digit":
            image = np.asarray(cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE), np.uint8)
        if image.shape[1::-1] != size:
            image = np.asarray(cv2.resize(image, size), np.uint8)
        return np.roll(image, _SHIFT_PX, axis=1) if shift else image

    def _set_rate(self, rate_hz: float) -> None:
        if rate_hz not in self._rates[self._size]:
            raise InputError(f"sensor: no rate {rate_hz:g} Hz at {self._size}; {self._rates[self._size]}")
        # images of the old rate that were not captured are numbered before the new rate begins
        self._skip_until(self._clock.now_ns())
        self._rate_hz = rate_hz
        period_ns = round(NS_PER_S / rate_hz)
        self._due_ns = round(self._phase * period_ns) + period_ns * -(-self._clock.now_ns() // period_ns)


def _numbers(value: Any, count: int) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count or not all(type(v) in (int, float) for v in value):
        raise InputError(f"sensor: {value!r}: give {count} number{'s' * (count > 1)}")
    return tuple(float(v) for v in value)


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


class MjpegServer(Part):
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
        super().__init__(f"stream of {serial}", self._serve)
        self.serial = serial
        phase = crc32(serial.encode()) % 1000 / 1000.0 if phase is None else phase
        self.sensor = MjpegSensor(render, rate_hz, clock, kind, on_light, phase)
        self.inject = self.sensor.faults.inject
        self._clock = clock
        self._to_monotonic_ns = SystemClock(slowness_of(clock)).now_ns() - clock.now_ns()
        handler = type("Handler", (_Handler,), {"served": self})
        server = type("Server", (QuietServer, HTTPServer), {})((host, 0), handler)
        self._http = BackgroundServer(server, poll_s=0.05)
        self._changed = threading.Condition()
        self._clients: list[deque[Capture]] = []

        self._counts = {"served": 0, "missed": 0, "withheld": 0, "skipped": 0}
        self._ranges: list[list[int]] = []

    @property
    def url(self) -> str:
        host, port = self._http.host_port
        return f"http://{host}:{port}/stream.mjpg"

    def start(self) -> None:
        self._http.start()
        super().start()

    def stop(self) -> None:
        self.stopping.set()
        self._http.stop()
        super().stop()

    def snapshot(self) -> dict[str, Any]:
        """Return the counts since the start.

        served: images sent to clients; ranges: [first, last] of each unbroken run of their numbers; missed:
        images not rendered in time; withheld: images lost by the fault "drop"; skipped: images lost by
        clients that read too slowly; clients: connected now.
        """
        with self._changed:
            ranges = [list(run) for run in self._ranges]
            first, last = (ranges[0][0], ranges[-1][1]) if ranges else (None, None)
            found = {"first": first, "last": last, "ranges": ranges, "clients": len(self._clients)}
            return {"serial": self.serial, **self._counts, **found}

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
            while not (self.stopping.is_set() or self.sensor.active("disconnect")):
                if queue:
                    return queue.popleft()
                self._changed.wait(POLL_S)
            return None

    def _serve(self) -> None:
        while not self.stopping.is_set():
            if self._http.failure is not None:
                raise self._http.failure
            with self._changed:
                if not self._clients:
                    self._changed.wait(POLL_S)
                    continue
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
