"""Shows a lift to viewers while it is measured. It only reads, so it changes no result."""

import os
from collections import deque
from collections.abc import Mapping

from drivers.clock import NS_PER_S, Clock
from drivers.types import ArmState, Frame
from protocols.observer import LiftEvents, Phase
from rig.lift.measurement import LiftMeasurement
from rig.live.feed import LiveFeed, Sender
from rig.live.pictures import Sparing, small_jpeg
from rig.sessions.records import LiftHead

LIFT_KEYS = ("number", "attempt", "object", "name", "lift", "simulated")
"""What tells lookers-on which lift a message is about."""
RATE_FRAMES = 31
"""Frames of a source whose times give its rate: a second of the camera's."""


class LiveObserver(LiftEvents):
    """Sends pictures and figures of a lift to viewers. It comes after the lift's measurement.

    head: of the lift; its `LIFT_KEYS` go with each message. clock: of real time, which limits the rate of
    messages, even if a simulated bench runs faster.
    """

    def __init__(
        self, measurement: LiftMeasurement, feed: LiveFeed, head: LiftHead, clock: Clock | None = None
    ) -> None:
        self._measurement = measurement
        self._sender = Sender(feed)
        self._pictures = feed.pictures
        self._lift = {**{key: getattr(head, key) for key in LIFT_KEYS}, "sender": os.getpid()}
        self._due = Sparing(clock).due
        self._times: dict[str, deque[int]] = {}
        self._phase = ""
        self._fused_sent = 0
        self._truth: list[tuple[int, float | None]] = []
        self._send("lift", {})

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase."""
        self._phase = phase.value
        self._send("phase", {"phase": phase.value, "time_ns": time_ns})

    def frame(self, frame: Frame) -> None:
        """Show a frame, unless one of its source was shown just before, and the newest figures."""
        self._times.setdefault(frame.serial, deque(maxlen=RATE_FRAMES)).append(frame.time_ns)
        if frame.serial not in self._measurement.angle.tips:
            self._truth.append((frame.time_ns, self._measurement.truth.latest_angle_deg()))
        if self._pictures and self._due(frame.serial):
            self._show(frame)
        if self._due("figures"):
            self._figures(frame.time_ns)

    def arm(self, state: ArmState) -> None:
        """Show the arm's pose."""
        if self._pictures and self._due("arm"):
            pose = state.base_T_tcp
            values = {"position_m": pose.position_m, "quaternion_xyzw": pose.quaternion_xyzw}
            self._send("arm", {"time_ns": state.time_ns, **values})

    def close(self) -> None:
        """Send what is left."""
        self._figures(max((times[-1] for times in self._times.values()), default=0))
        self._sender.close()

    def _show(self, frame: Frame) -> None:
        jpeg, scale = small_jpeg(frame.image)
        values: dict[str, object] = {"serial": frame.serial, "time_ns": frame.time_ns}
        if frame.serial not in self._measurement.angle.tips:
            values["source"] = "camera"
            corners = self._measurement.truth.latest_corners_px()
            # OpenCV has whole numbers at a pixel's middle, viewers have halves
            values["markers_px"] = None if corners is None else ((corners + 0.5) * scale).round(2).tolist()
        self._send("frame", values, jpeg)

    def _figures(self, time_ns: int) -> None:
        fused = self._measurement.angle.fused[self._fused_sent :]
        self._fused_sent = len(self._measurement.angle.fused)
        values = {
            "time_ns": time_ns,
            "phase": self._phase,
            "estimate": [(s.time_ns, s.angle_deg, s.sigma_deg) for s in fused],
            "truth": self._truth,
            "rates_hz": self._rates_hz(),
            "dropped": {name: tally.dropped for name, tally in self._measurement.tallies.items()},
        }
        self._truth = []
        self._send("figures", values)

    def _rates_hz(self) -> dict[str, float | None]:
        """Frames a second of each source: fingertips in the order of the bench file, then the camera."""
        tips = self._measurement.angle.tips
        camera = next((times for serial, times in self._times.items() if serial not in tips), None)
        return {**{tip: _rate(self._times.get(tip)) for tip in tips}, "camera": _rate(camera)}

    def _send(self, kind: str, values: Mapping[str, object], picture: bytes = b"") -> None:
        self._sender.send(kind, {**self._lift, **values}, picture)


def _rate(times: "deque[int] | None") -> float | None:
    """Return frames per second of the bench's time."""
    if times is None:
        return None
    span = times[-1] - times[0]
    return None if span <= 0 else round((len(times) - 1) * NS_PER_S / span, 1)
