"""The history of a stored clip for the page of `rig show`, with the angles of `rig estimate`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from drivers.formats import number_in, read_csv_rows
from rig.frames.estimates import EstimatedSeries
from rig.lift.object_angle import object_angle
from rig.live.clip_writer import MARKS
from rig.live.desk import picture
from rig.live.desk_sensor import Reading
from rig.live.feed import OBJECT, Message
from rig.live.state import HISTORY_S, History
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.sample import State


def stored_history(shown: Sequence[EstimatedSeries], lift_ns: int | None, folder: Path) -> History:
    """Return the history of a clip, or of the fingertips of a lift: the last `HISTORY_S` at most.

    shown: at least one. lift_ns: start of a lift with two fingertips, whose angles are fused from then on.
    folder: of the clip, which may contain marks.
    """
    times_ns = [sample.time_ns for one in shown for sample in one.estimate.samples if not sample.jumped]
    first_ns, last_ns = min(times_ns), max(times_ns)
    began_s = first_ns / NS_PER_S
    history = History(began_s=began_s)
    for one in shown:
        _add_series(history, one, last_ns - to_ns(HISTORY_S))
    if len(shown) > 1 and lift_ns is not None:
        samples = {one.name: one.estimate.samples for one in shown}
        for sample in object_angle(dict.fromkeys(samples, 1), samples, lift_ns).fused:
            state = sample.disagreement or sample.state.value
            history.take(_message(Reading(OBJECT, sample.time_ns, state, sample)))
    for time_s, text in _marks(folder / MARKS):
        history.add_event(text, began_s + time_s)
    return history


def _add_series(history: History, one: EstimatedSeries, from_ns: int) -> None:
    finder, zero = ContactFinder(one.untouched), one.estimate.zero
    zero_s = None if zero is None else zero.time_ns / NS_PER_S
    times_s = [sample.time_ns / NS_PER_S for sample in one.estimate.samples]
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    fps = 1.0 / step_s if step_s > 0.0 else None
    for frame, sample in zip(one.frames, one.estimate.samples, strict=True):
        if sample.jumped or sample.time_ns < from_ns:
            continue
        reading = Reading(one.name, sample.time_ns, sample.state.value, sample, fps, zero_s=zero_s)
        sensor = history.sensors.get(one.name)
        if frame.image is None or not (sensor is None or sensor.keeps_image(sample.time_s, reading.state)):
            history.take(_message(reading))
            continue
        contour = np.empty((0, 2), np.float32)
        if sample.state is not State.NO_CONTACT:
            contour = finder.find(frame.image).contour.reshape(-1, 2).astype(np.float32)
        jpeg, outline = picture(frame.image, None, contour)
        history.take(_message(reading, outline, jpeg))


def _message(reading: Reading, outline: Sequence[object] = (), jpeg: bytes = b"") -> Message:
    return Message("sensor", {"recording": False, **reading.values(), "outline": outline}, jpeg)


def _marks(file: Path) -> list[tuple[float, str]]:
    """Return time in s and text of the marks in a clip, if it has any. Raises `InputError`."""
    if not file.is_file():
        return []
    rows = read_csv_rows(file, ("time_s", "text"))
    return [(number_in(row, "time_s", f"{file}: line {line}"), row["text"]) for line, row in rows]
