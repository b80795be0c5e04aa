"""Serves a simulated DIGIT or camera as Motion JPEG over HTTP, with a side channel.

    GET  /stream.mjpg    the images; any MJPEG client can read them (OpenCV, curl, a browser)
    GET  /snapshot.jpg   the next image
    GET  /status         counts, as JSON
    POST /control        {"size_px": [320, 240]}, {"rate_hz": 60}, {"light": [1, 1, 1]}
    POST /fault          {"kind": "freeze", "duration_s": 1.0} or {"kind": "drop", "frames": 2}

Each part carries its number (X-Sequence) and its capture time (X-Timestamp, s of the computer's
monotonic clock), so that what was served can be compared with what was recorded.
"""

import threading
from collections import deque
from collections.abc import Iterator
from typing import Any
from zlib import crc32

from drivers.clock import NS_PER_S, Clock, SystemClock, to_ns
from fakes.wire.mjpeg.http import HttpSide
from fakes.wire.mjpeg.sensor import Capture, Kind, MjpegSensor, OnLight, Render
from fakes.wire.net.background import VitalThread

LATENCY_S = 0.004
"""From capture to rendering: by then the world has come as far as the image shows it."""
PATIENCE_S = 0.25
"""Images that could not be rendered in this time are given up, and counted as missed."""
QUEUE = 32
POLL_S = 0.1


class MjpegServer:
    """One sensor behind one port. `start` and `stop` it; `url` is its stream.

    render: draws the (H, W, 3) uint8 RGB image of a time in ns of `clock`, upright; it runs in
    the server's thread, and only while a client is there. kind: "digit" (raw images lie on their
    side, 320 x 240 at 60 or 30 Hz, 640 x 480 at 30 or 15) or "camera". port 0 takes a free one.
    phase: when within its period it captures, 0 to 1; one of its own by its serial when None.
    """

    def __init__(
        self,
        serial: str,
        render: Render,
        rate_hz: float,
        clock: Clock,
        host: str = "127.0.0.1",
        port: int = 0,
        kind: Kind = "digit",
        on_light: OnLight | None = None,
        phase: float | None = None,
    ) -> None:
        self.serial = serial
        phase = _phase_of(serial) if phase is None else phase
        self.sensor = MjpegSensor(render, rate_hz, clock, kind, on_light, phase)
        self._clock = clock
        self._to_monotonic_ns = SystemClock().now_ns() - clock.now_ns()
        self._http = HttpSide(host, port, self)
        self._changed = threading.Condition()
        self._clients: list[deque[Capture]] = []
        self._stopping = threading.Event()
        self._thread = VitalThread(self._work, f"stream of {serial}")
        self._counts = {"served": 0, "missed": 0, "withheld": 0, "skipped": 0}
        self._ranges: list[list[int]] = []

    @property
    def url(self) -> str:
        """Address of the stream."""
        host, port = self._http.host_port
        return f"http://{host}:{port}/stream.mjpg"

    @property
    def failure(self) -> Exception | None:
        """What ended the stream by itself; None where nothing did."""
        return self._thread.failure or self._http.failure

    def start(self) -> None:
        """Begin to answer; returns at once."""
        self._http.start()
        self._thread.start()

    def stop(self) -> None:
        """End all connections and give the port back."""
        self._stopping.set()
        self._http.stop()
        if self._thread.is_alive():
            self._thread.join()

    def inject(self, kind: str, **args: Any) -> None:
        """Begin a fault, see `MjpegSensor.inject`. Raises `InputError`."""
        self.sensor.inject(kind, **args)

    def snapshot(self) -> dict[str, Any]:
        """Counts since the start.

        served: images given to clients; ranges: their numbers, as [first, last] of each unbroken
        run; missed: not rendered in time; withheld: by the fault "drop"; skipped: lost by clients
        that read too slowly; clients: now.
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
        """Join the stream: its captures from now on, until it stops or is torn off."""
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

    def headers_of(self, capture: Capture) -> dict[str, str]:
        """What is sent before an image: its type, length, number and capture time."""
        time_ns = capture.time_ns + self._to_monotonic_ns
        return {
            "Content-Type": "image/jpeg",
            "Content-Length": str(len(capture.jpeg)),
            "X-Sequence": str(capture.number),
            "X-Timestamp": f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}",
        }

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


def _phase_of(serial: str) -> float:
    """A unit captures at a time of its own within a period, the same on every run."""
    return crc32(serial.encode()) % 1000 / 1000.0
