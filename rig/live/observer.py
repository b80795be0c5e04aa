"""Shows a lift, or the frames of a recording, to viewers. It only reads, so it changes no result."""

import os
from collections import deque
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.images import encode_jpeg
from drivers.types import Frame, Image
from protocols.observer import LiftEvents, Phase
from rig.lift.measurement import LiftMeasurement
from rig.live.feed import Listener, Sender
from rig.sessions.records import Lift

MOST_PER_S = 10.0
"""Images of one source, and sets of figures, per second of real time."""
PICTURE_LONG_SIDE_PX = 320
PICTURE_QUALITY = 80
LIFT_KEYS = ("number", "object", "name", "lift")
"""Fields that identify the lift of a message."""
RATE_FRAMES = 31
"""Number of frames for the computation of a source's rate: one second of the camera."""


class Sparing:
    """Rate limiter: at most `MOST_PER_S` times per second for each name, by default of real time."""

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self._passed_ns: dict[str, int] = {}

    def due(self, what: str) -> bool:
        """Return whether `what` may be sent now; if so, its interval starts again."""
        now = self._clock.now_ns()
        if now - self._passed_ns.get(what, -NS_PER_S) < NS_PER_S / MOST_PER_S:
            return False
        self._passed_ns[what] = now
        return True


class PictureSender:
    """Sends small images of frames to viewers if no lift is measured."""

    def __init__(self, listeners: Sequence[Listener]) -> None:
        self._sender, self._due = Sender(listeners), Sparing().due

    def __call__(self, frame: Frame) -> None:
        """Send a frame, subject to the rate limit of its source, if a listener shows images."""
        if self._sender.pictures and self._due(frame.serial):
            values = {"serial": frame.serial, "time_ns": frame.time_ns, "sender": os.getpid()}
            self._sender.send("frame", values, small_jpeg(frame.image)[0])

    def close(self) -> None:
        self._sender.close()


def small_jpeg(image: Image) -> tuple[bytes, float]:
    """Return a JPEG of at most `PICTURE_LONG_SIDE_PX`, and its scale."""
    scale = min(1.0, PICTURE_LONG_SIDE_PX / max(image.shape[:2]))
    if scale < 1.0:
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        image = np.asarray(small, np.uint8)
    return encode_jpeg(image, PICTURE_QUALITY), scale


class LiveObserver(LiftEvents):
    """Sends images and figures of a lift to viewers. Events must reach the lift's measurement first.

    lift: its `LIFT_KEYS` go with each message. Message rates are limited in real time, even if a
    simulated bench runs faster.
    """

    def __init__(self, measurement: LiftMeasurement, listeners: Sequence[Listener], lift: Lift) -> None:
        self._measurement, self._sender = measurement, Sender(listeners)
        self._lift = {**{key: getattr(lift, key) for key in LIFT_KEYS}, "sender": os.getpid()}
        self._due = Sparing().due
        self._times: dict[str, deque[int]] = {}
        self._phase = ""
        self._fused_sent = 0
        self._truth: list[tuple[int, float | None]] = []
        self._send("lift", {})

    def phase(self, phase: Phase, time_ns: int) -> None:
        self._phase = phase.value
        self._send("phase", {"phase": phase.value, "time_ns": time_ns})

    def frame(self, frame: Frame) -> None:
        self._times.setdefault(frame.serial, deque(maxlen=RATE_FRAMES)).append(frame.time_ns)
        if frame.serial not in self._measurement.angle.tips:
            self._truth.append((frame.time_ns, self._measurement.truth.latest_angle_deg()))
        if self._sender.pictures and self._due(frame.serial):
            values = {"serial": frame.serial, "time_ns": frame.time_ns}
            self._send("frame", values, small_jpeg(frame.image)[0])
        if self._due("figures"):
            self._figures(frame.time_ns)

    def close(self) -> None:
        """Send the last figures and close the socket."""
        self._figures(max((times[-1] for times in self._times.values()), default=0))
        self._sender.close()

    def _figures(self, time_ns: int) -> None:
        tips = self._measurement.angle.tips
        camera = next((times for serial, times in self._times.items() if serial not in tips), None)
        fused = self._measurement.angle.fused[self._fused_sent :]
        self._fused_sent = len(self._measurement.angle.fused)
        values = {
            "time_ns": time_ns,
            "phase": self._phase,
            "estimate": [(s.time_ns, s.angle_deg, s.sigma_deg) for s in fused],
            "truth": self._truth,
            # fingertips in the order of the bench file, then the camera
            "rates_hz": {**{tip: _rate(self._times.get(tip)) for tip in tips}, "camera": _rate(camera)},
            "dropped": {name: tally.dropped for name, tally in self._measurement.tallies.items()},
        }
        self._truth = []
        self._send("figures", values)

    def _send(self, kind: str, values: Mapping[str, object], picture: bytes = b"") -> None:
        self._sender.send(kind, {**self._lift, **values}, picture)


def _rate(times: "deque[int] | None") -> float | None:
    if times is None:
        return None
    span = times[-1] - times[0]
    return None if span <= 0 else round((len(times) - 1) * NS_PER_S / span, 1)
