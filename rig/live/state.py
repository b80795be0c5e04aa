"""State of lifts, sensors and commands, as the terminal and the pages of `--watch` and `rig live` show it."""

import json
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from typing import Any

from drivers.clock import NS_PER_S
from rig.live.feed import NO_FRAMES, OBJECT, Message
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
"""Smallest spacing and largest number of the points of a lift's angle curve: half a minute in all."""
HISTORY_S, KEPT_FRAMES = 600.0, 36_000
"""Length of the history of a live sensor, and its most frames: those of a DIGIT, 60 per second."""
PICTURES_PER_S, KEPT_PICTURE_BYTES = 5, 48_000_000
"""Images per second in the history of a sensor, and their most bytes: 10 minutes of images of 16 kB."""
TIME_DIGITS = 6
"""Decimals of the times of points and events in s; equal ones, so that an event leads to its frame."""
KEPT_EVENTS, MERGED_S = 300, 1.0
"""Most events in the list; events of one kind and sensor are counted together up to this time apart."""
SENT_POINTS = 2000
"""Most points per sensor in one record, so that a long history delays no new frame."""
WITH_CONTACT = ("tracking", "rekeyed", "unobservable", "lost")
"""States of an estimate with contact, see `rig.tactile.sample.State`."""
UNKNOWN = ("frozen", NO_FRAMES)
"""States in which it is unknown whether there is a contact."""
NOTICE_S = 5.0
"""Time for which a page with sensors shows a notice; after that it shows the next step for their state."""
SILENT_S = 3.0
"""Images of one process are shown; after this time without an image, those of another process."""

Points = deque[tuple[float, float | None]]
"""Times in s from a lift's first frame, angles in degrees, None if refused."""


@dataclass(slots=True)
class SensorOnPage:
    """A live sensor, or the object: its newest reading and image, and its history of `HISTORY_S`.

    points: per frame, see `take`. added: total number of points so far. pictures: time in s and record of
    each kept image, see `RECORD_HEAD`, with the outline of the contact; `forgotten` images came before them.
    contact: whether there was a contact when it was known last.
    """

    reading: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""
    points: deque[tuple[Any, ...]] = field(default_factory=lambda: deque(maxlen=KEPT_FRAMES))
    added: int = 0
    pictures: deque[tuple[float, bytes]] = field(default_factory=deque)
    forgotten: int = 0
    picture_bytes: int = 0
    contact: bool = False

    def take(self, message: Message) -> None:
        """Add a reading to the history.

        A point has time in s, angle and sigma in degrees, time of the reference in s, number of dropped
        frames so far, rate in degrees/s, state, slip alarm, and the number of the image if it is kept.
        """
        values = message.values
        time_s, number = round(values["t_s"], TIME_DIGITS), None
        if self.points and time_s < self.points[-1][0]:  # the clock was set back: a new history
            self.points.clear()
            self._forget(float("inf"))
        if message.picture and self.keeps_image(time_s, values["state"]):
            number = self.forgotten + len(self.pictures)
            head = json.dumps({"t_s": time_s, "outline": values["outline"]}).encode()
            record = RECORD_HEAD.pack(len(head), len(message.picture)) + head + message.picture
            self.pictures.append((time_s, record))
            self.picture_bytes += len(record)
        self.reading, self.picture = values, message.picture
        self.contact = self.contact_in(values["state"])
        angle, sigma, rate = (_short(values[key]) for key in ("angle_deg", "sigma_deg", "rate_deg_s"))
        marks = values["zero_s"], values["dropped"]
        state = sys.intern(values["state"])
        self.points.append((time_s, angle, sigma, *marks, rate, state, values["slip"], number))
        self.added += 1
        while self.points[0][0] < time_s - HISTORY_S:
            self.points.popleft()
        self._forget(time_s - HISTORY_S)

    def keeps_image(self, time_s: float, state: str) -> bool:
        """Whether the next frame's image is kept: `PICTURES_PER_S`, and where a contact begins or ends."""
        last_s = self.pictures[-1][0] if self.pictures else -1.0
        changed = self.contact_in(state) != self.contact
        return changed or int(round(time_s, TIME_DIGITS) * PICTURES_PER_S) > int(last_s * PICTURES_PER_S)

    def contact_in(self, state: str) -> bool:
        """Whether a state of the next frame has contact; one of `UNKNOWN` has it if there was one before."""
        return self.contact if state in UNKNOWN else state in WITH_CONTACT

    def since(self, known: int) -> tuple[dict[str, Any], int]:
        """Return the reading and the points after the first `known`, as JSON values, and the number known.

        At most `SENT_POINTS` are returned.
        """
        first = max(len(self.points) - (self.added - known), 0)
        points = [self.points[i] for i in range(first, min(first + SENT_POINTS, len(self.points)))]
        known = self.added - len(self.points) + first + len(points)
        return {**self.reading, "points": points, "bytes": len(self.picture)}, known

    def past(self, number: int) -> bytes | None:
        """Return the record of a kept image; None if there is none with this number."""
        place = number - self.forgotten
        return self.pictures[place][1] if 0 <= place < len(self.pictures) else None

    def _forget(self, before_s: float) -> None:
        """Remove the images from before a time, and the oldest ones beyond the limit of bytes."""
        while self.pictures and (self.pictures[0][0] < before_s or self.picture_bytes > KEPT_PICTURE_BYTES):
            self.picture_bytes -= len(self.pictures.popleft()[1])
            self.forgotten += 1


def _short(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


@dataclass(slots=True)
class History:
    """The histories of all sensors and the events, as the page shows them.

    events: oldest first, each with number, time in s, sensor, text, and how often it occurred. changes:
    number of changes of the events. began_s: time of the first frame of a stored clip, s; None for a live
    view.
    """

    sensors: dict[str, SensorOnPage] = field(default_factory=dict)
    events: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=KEPT_EVENTS))
    changes: int = 0
    began_s: float | None = None

    def take(self, message: Message) -> None:
        """Add the reading of a sensor, with the events between it and the reading before."""
        name = message.values["sensor"]
        sensor = self.sensors.setdefault(name, SensorOnPage())
        before, contact = sensor.reading, sensor.contact
        sensor.take(message)
        if name == OBJECT:
            return
        if sensor.contact != contact:
            self.add_event("contact" if sensor.contact else "contact ended", message.values["t_s"], name)
        for text, time_s in _events(before, message.values):
            self.add_event(text, time_s, name)

    def add_event(self, text: str, time_s: float, sensor: str = "") -> None:
        """Add an event, or count it with one of the same text and sensor less than `MERGED_S` before."""
        self.changes += 1
        time_s = round(time_s, TIME_DIGITS)
        same = (e for e in reversed(self.events) if (e["text"], e["sensor"]) == (text, sensor))
        last = next(same, None)
        if last is None or not 0.0 <= time_s - last["last_s"] < MERGED_S:
            values = {"t_s": time_s, "last_s": time_s, "sensor": sensor, "text": text, "count": 1}
            self.events.append({"number": self.changes, **values})
        else:
            last["last_s"], last["count"] = time_s, last["count"] + 1


def _events(before: dict[str, Any], now: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield text and time in s of the events between two readings of a sensor; the first may be {}.

    `History.take` adds those where a contact begins or ends.
    """
    if now["state"] in UNKNOWN and now["state"] != before.get("state"):
        yield now["state"], now["t_s"]
    if now["zero_s"] not in (None, before.get("zero_s")):
        yield "zero", now["zero_s"]
    if now["slip"] and not before.get("slip"):
        yield "slip", now["t_s"]
    if now["background"] not in ("", before.get("background")):
        yield f"background {now['background']}", now["t_s"]


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
    """The displayed state. take: returns the messages of lifts since the last call, oldest first.

    lock: held while the state is read or changed, by the server's thread and by that of `rig.live.watch`.
    """

    progress: Progress
    take: Callable[[], list[Message]]
    history: History = field(default_factory=History)
    version: int = 0
    """Number of changes by messages of lifts and sensors."""
    notice: str = ""
    noticed_s: float = 0.0
    """Time at which the notice arrived, s by `time.monotonic`."""
    lock: threading.RLock = field(default_factory=threading.RLock)
    _lifts: dict[int, LiftInView] = field(default_factory=dict)
    _pictures: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    _followed: int | None = None
    _followed_at_s: float = -SILENT_S

    def values(self) -> dict[str, Any]:
        """Return the state without images, as JSON values."""
        with self.lock:
            self.read()
            newest_s = time.monotonic() - NOTICE_S
            lifts = sorted(self._lifts.values(), key=lambda lift: lift.number)
            return {
                **asdict(self.progress),
                "lifts": [lift.values() for lift in lifts],
                "pictures": {serial: number for serial, (number, _) in self._pictures.items()},
                "notice": self.notice if not self.history.sensors or self.noticed_s > newest_s else "",
                "events": list(self.history.events),
                "began_s": self.history.began_s,
            }

    def picture(self, serial: str) -> bytes | None:
        """Return the newest JPEG of a source; None if there is none."""
        self.read()
        return self._pictures.get(serial, (0, None))[1]

    def past(self, name: str, number: str) -> bytes | None:
        """Return the record of a kept image of a live sensor; None without one of this name and number."""
        with self.lock:
            sensor = self.history.sensors.get(name)
            known = sensor is not None and number.isascii() and number.isdecimal() and len(number) < 10
            return sensor.past(int(number)) if sensor is not None and known else None

    def read(self) -> None:
        with self.lock:
            for message in self.take():
                self.version += 1
                self._read(message)

    def _read(self, message: Message) -> None:
        values = message.values
        if message.kind == "notice":
            self.notice, self.noticed_s = str(values["text"])[:MOST_CHARACTERS], time.monotonic()
        elif message.kind == "sensor":
            self.history.take(message)
        elif message.kind == "mark":
            self.history.add_event(values["text"], values["t_s"])
        elif message.picture:
            now_s, sender, serial = time.monotonic(), values["sender"], values["serial"]
            if sender == self._followed or now_s >= self._followed_at_s + SILENT_S:
                self._followed, self._followed_at_s = sender, now_s
                number = self._pictures.get(serial, (0, b""))[0] + 1
                self._pictures[serial] = (number, message.picture)
        elif "number" in values:
            update_lifts(self._lifts, message)
            if len(self._lifts) > KEPT_LIFTS:
                self._lifts.pop(next(iter(self._lifts)))


class StateNews:
    """The changes that one browser has not received yet, as records: see `RECORD_HEAD`.

    A record is the state as in `state.json`, its events only if they have changed, and for each live sensor
    its newest reading, new points, and its image if the browser does not have it yet. A browser gets the
    history in several records, oldest first.
    """

    def __init__(self, state: WatchState) -> None:
        self._state = state
        self._known: dict[str, int] = {}
        self._times: dict[str, float] = {}
        self._version: tuple[int, Progress] | None = None
        self._changes = -1
        self._sent_s = 0.0

    def __call__(self) -> bytes:
        """Return the next record, b"" if nothing has changed."""
        with self._state.lock:
            return self._next()

    def _next(self) -> bytes:
        now_s, history = time.monotonic(), self._state.history
        if not history.sensors and now_s < self._sent_s + WATCH_EVERY_S:
            self._state.read()
            return b""
        values = self._state.values()
        version = (self._state.version, self._state.progress)
        complete = all(self._known.get(name) == sensor.added for name, sensor in history.sensors.items())
        if version == self._version and complete:
            return b""
        self._version, self._sent_s = version, now_s
        if self._changes == history.changes:
            del values["events"]
        self._changes = history.changes
        sensors, pictures = [], b""
        for name, sensor in sorted(history.sensors.items(), key=lambda item: (not item[1].picture, item[0])):
            shown, self._known[name] = sensor.since(self._known.get(name, 0))
            if self._times.get(name) == sensor.reading["t_s"]:
                shown["bytes"] = 0
            else:
                pictures += sensor.picture
            self._times[name] = sensor.reading["t_s"]
            sensors.append(shown)
        head = json.dumps({**values, "sensors": sensors}).encode()
        return RECORD_HEAD.pack(len(head), len(pictures)) + head + pictures
