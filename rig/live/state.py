"""State of lifts, sensors and commands, as the terminal and the pages of `--watch` and `rig live` show it."""

import json
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from typing import Any

from drivers.clock import NS_PER_S
from rig.live.feed import Message
from rig.terminal.onlookers import Event

RECORD_HEAD = struct.Struct(">II")
"""Head of each record of `/stream`: length of its JSON, total length of the images after it."""
WATCH_EVERY_S = 0.5
"""Interval of the updates of a page without live sensors."""
KEPT_FAULTS, MOST_CHARACTERS = 20, 2000
KEPT_FINISHED = 60
KEPT_LIFTS = 16
"""Number of processes whose newest lift is shown."""
POINTS_APART_S, KEPT_POINTS = 0.05, 600
"""Smallest spacing and largest number of the points of an angle curve: half a minute in all."""
SILENT_S = 3.0
"""Images of one process are shown; after this time without an image, those of another process."""

Points = deque[tuple[float, float | None]]
"""Times in s from a lift's first frame, angles in degrees, None if refused."""


@dataclass(slots=True)
class SensorOnPage:
    """A live sensor, or the object: its newest reading, its image and the curve of its angle.

    points: time in s of the bench's clock, angle and sigma in degrees, time of the reference in s, number of
    dropped frames so far. added: total number of points so far.
    """

    reading: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""
    points: deque[tuple[float, float | None, float | None, float | None, int]] = field(
        default_factory=lambda: deque(maxlen=KEPT_POINTS)
    )
    added: int = 0

    def take(self, message: Message) -> None:
        values = self.reading = message.values
        self.picture = message.picture
        time_s, angle_deg = values["t_s"], values["angle_deg"]
        marks = values["zero_s"], values["dropped"]
        last = self.points[-1] if self.points else None
        if (
            last is None
            or time_s >= last[0] + POINTS_APART_S
            or (angle_deg is None) != (last[1] is None)
            or marks != last[3:]
        ):
            self.points.append((time_s, angle_deg, values["sigma_deg"], *marks))
            self.added += 1

    def since(self, known: int) -> dict[str, Any]:
        """Return the reading, and the points after the first `known`, as JSON values."""
        new = min(self.added - known, len(self.points))
        points = list(self.points)[len(self.points) - new :]
        return {**self.reading, "points": points, "bytes": len(self.picture)}


@dataclass(slots=True)
class LiftInView:
    """A lift in progress after the messages received so far; angles in degrees, None without an answer.

    estimate, truth: the curves of its angles.
    """

    number: int
    title: str
    phase: str = ""
    estimate_deg: float | None = None
    truth_deg: float | None = None
    rates_hz: dict[str, float | None] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    began_ns: int | None = None
    newest_ns: int = 0
    estimate: Points = field(default_factory=lambda: deque(maxlen=KEPT_POINTS))
    truth: Points = field(default_factory=lambda: deque(maxlen=KEPT_POINTS))

    def take(self, message: Message) -> None:
        values = message.values
        self.phase = values.get("phase", self.phase)
        if "time_ns" in values:
            self.began_ns = values["time_ns"] if self.began_ns is None else self.began_ns
            self.newest_ns = max(self.newest_ns, values["time_ns"])
        if message.kind == "figures":
            self.rates_hz, self.dropped = values["rates_hz"], values["dropped"]
            for time_ns, angle_deg, *_ in values["estimate"]:
                self.estimate_deg = angle_deg
                self._add(self.estimate, time_ns, angle_deg)
            for time_ns, angle_deg in values["truth"]:
                self.truth_deg = angle_deg
                self._add(self.truth, time_ns, angle_deg)

    @property
    def seen_s(self) -> float:
        """Time since the first message of the lift, s by the bench's clock."""
        return 0.0 if self.began_ns is None else (self.newest_ns - self.began_ns) / NS_PER_S

    def angles(self) -> str:
        estimate, truth = ("-" if a is None else f"{a:+.1f} deg" for a in (self.estimate_deg, self.truth_deg))
        return f"{self.title}, phase {self.phase or '-'}: estimate {estimate}, markers {truth}"

    def frames(self) -> str:
        rates = ", ".join(
            f"{source} {'-' if rate is None else f'{rate:.0f}'}" for source, rate in self.rates_hz.items()
        )
        return f"frames/s {rates or '-'}; dropped {sum(self.dropped.values())}"

    def values(self) -> dict[str, Any]:
        names = ("title", "phase", "estimate_deg", "truth_deg")
        curves = {"estimate": list(self.estimate), "truth": list(self.truth)}
        return {**{name: getattr(self, name) for name in names}, "frames": self.frames(), **curves}

    def _add(self, points: Points, time_ns: int, angle_deg: float | None) -> None:
        time_s = round((time_ns - (self.began_ns or 0)) / NS_PER_S, 2)
        answered = angle_deg is not None
        if points and time_s < points[-1][0] + POINTS_APART_S and answered == (points[-1][1] is not None):
            return
        points.append((time_s, None if angle_deg is None else round(angle_deg, 2)))


def update_lifts(lifts: dict[int, LiftInView], message: Message) -> None:
    """Update the lifts in progress, by the process that sends their messages; its previous lift is over."""
    sender, values = message.values["sender"], message.values
    lift = lifts.get(sender)
    if lift is None or lift.number != values["number"]:
        lifts.pop(sender, None)
        title = f"{values['object']} {values['name']} lift {values['lift']}"
        lift = lifts[sender] = LiftInView(values["number"], title)
    lift.take(message)


@dataclass(frozen=True, slots=True)
class Progress:
    """State of a command for the page. title: its name. what: name of its pieces of work, such as "lifts".

    newest: text about the piece finished last. finished: texts about the pieces finished while the page was
    served, newest first. question: the question that waits for an answer. ended: outcome of the command.
    faults: newest first, with the time of day. report: path of the report, once it is written.
    """

    title: str
    what: str
    done: int
    total: int
    newest: str = ""
    question: str = ""
    ended: str = ""
    faults: Sequence[str] = ()
    finished: Sequence[str] = ()
    report: str = ""

    def after(self, event: Event) -> "Progress":
        text = event.text[:MOST_CHARACTERS]
        if event.kind == "progress":
            finished = (f"{event.done}/{event.total} {text}", *self.finished)[:KEPT_FINISHED]
            return replace(self, newest=text, done=event.done, total=event.total, finished=finished)
        if event.kind == "fault":
            faults = (f"{datetime.now():%H:%M:%S} {text}", *self.faults)
            return replace(self, faults=faults[:KEPT_FAULTS])
        if event.kind == "end":
            return replace(self, ended=text, question="")
        return replace(self, question=text)


@dataclass(slots=True)
class WatchState:
    """The displayed state. take: returns the messages of lifts since the last call, oldest first."""

    progress: Progress
    take: Callable[[], list[Message]]
    version: int = 0
    """Number of changes by messages of lifts and sensors."""
    notice: str = ""
    sensors: dict[str, SensorOnPage] = field(default_factory=dict)
    _lifts: dict[int, LiftInView] = field(default_factory=dict)
    _pictures: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    _followed: int | None = None
    _followed_at_s: float = -SILENT_S

    def values(self) -> dict[str, Any]:
        """Return the state without images, as JSON values."""
        self.read()
        lifts = sorted(self._lifts.values(), key=lambda lift: lift.number)
        return {
            **asdict(self.progress),
            "lifts": [lift.values() for lift in lifts],
            "pictures": {serial: number for serial, (number, _) in self._pictures.items()},
            "notice": self.notice,
        }

    def picture(self, serial: str) -> bytes | None:
        """Return the newest JPEG of a source; None if there is none."""
        self.read()
        return self._pictures.get(serial, (0, None))[1]

    def read(self) -> None:
        for message in self.take():
            self.version += 1
            if message.kind == "notice":
                self.notice = str(message.values["text"])[:MOST_CHARACTERS]
            elif message.kind == "sensor":
                self.sensors.setdefault(message.values["sensor"], SensorOnPage()).take(message)
            elif message.picture:
                now_s, sender, serial = time.monotonic(), message.values["sender"], message.values["serial"]
                if sender == self._followed or now_s >= self._followed_at_s + SILENT_S:
                    self._followed, self._followed_at_s = sender, now_s
                    number = self._pictures.get(serial, (0, b""))[0] + 1
                    self._pictures[serial] = (number, message.picture)
            elif "number" in message.values:
                update_lifts(self._lifts, message)
                if len(self._lifts) > KEPT_LIFTS:
                    self._lifts.pop(next(iter(self._lifts)))


class StateNews:
    """The changes that one browser has not received yet, as records: see `RECORD_HEAD`.

    A record is the state as in `state.json`, and for each live sensor its newest reading, its new points, and
    its image if the browser does not have it yet.
    """

    def __init__(self, state: WatchState) -> None:
        self._state = state
        self._known: dict[str, int] = {}
        self._times: dict[str, float] = {}
        self._version: tuple[int, Progress] | None = None
        self._sent_s = 0.0

    def __call__(self) -> bytes:
        """Return the next record, b"" if nothing has changed."""
        now_s = time.monotonic()
        if not self._state.sensors and now_s < self._sent_s + WATCH_EVERY_S:
            self._state.read()
            return b""
        values = self._state.values()
        version = (self._state.version, self._state.progress)
        if version == self._version:
            return b""
        self._version, self._sent_s = version, now_s
        sensors, pictures = [], b""
        for name, sensor in sorted(
            self._state.sensors.items(), key=lambda item: (not item[1].picture, item[0])
        ):
            shown = sensor.since(self._known.get(name, 0))
            self._known[name] = sensor.added
            if self._times.get(name) == sensor.reading["t_s"]:
                shown["bytes"] = 0
            else:
                pictures += sensor.picture
            self._times[name] = sensor.reading["t_s"]
            sensors.append(shown)
        head = json.dumps({**values, "sensors": sensors}).encode()
        return RECORD_HEAD.pack(len(head), len(pictures)) + head + pictures
