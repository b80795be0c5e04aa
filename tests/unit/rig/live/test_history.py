"""The history of the live page: its bounds, its images, its events, and the history of a stored clip."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import FormatError
from rig.frames.estimates import Estimation
from rig.frames.series import read_frames
from rig.live import state
from rig.live.clip_writer import MARKS
from rig.live.feed import NO_FRAMES, OBJECT, Message
from rig.live.state import (
    HISTORY_S,
    KEPT_EVENTS,
    NOTICE_S,
    RECORD_HEAD,
    History,
    Progress,
    SensorOnPage,
    StateNews,
    WatchState,
)
from rig.live.stored_clip import stored_history
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State
from support.desk_frames import write_desk_clip

JPEG = b"\xff\xd8 a picture"


def message(time_s: float, jpeg: bytes = JPEG, sensor: str = "D1", **more: object) -> Message:
    values: dict[str, Any] = {
        "sensor": sensor, "t_s": time_s, "state": "tracking", "angle_deg": time_s, "sigma_deg": 0.5,
        "rate_deg_s": 1.0, "slip": False, "zero_s": None, "dropped": 0, "background": "", "outline": [[1, 2]],
    }  # fmt: skip
    return Message("sensor", {**values, **more}, jpeg)


def filled(seconds: float, rate_hz: float = 10.0, jpeg: bytes = JPEG) -> SensorOnPage:
    sensor = SensorOnPage()
    for number in range(round(seconds * rate_hz)):
        sensor.take(message(number / rate_hz, jpeg))
    return sensor


def unpacked(record: bytes) -> tuple[dict[str, Any], bytes]:
    head, picture = RECORD_HEAD.unpack(record[:8])
    assert len(record) == 8 + head + picture
    return json.loads(record[8 : 8 + head]), record[8 + head :]


def test_frame_with_the_time_of_the_one_before_does_not_end_the_history() -> None:
    sensor = SensorOnPage()
    for time_s in (1.0, 1.2345678, 1.2345678):  # rounded up to microseconds
        sensor.take(message(time_s))
    assert [point[0] for point in sensor.points] == [1.0, 1.234568, 1.234568]


def test_image_is_kept_where_a_contact_begins_and_ends_and_after_the_clock_was_set_back() -> None:
    sensor = SensorOnPage()
    for time_s, name in ((5.0, "no_contact"), (5.1, "tracking"), (5.11, "tracking"), (5.12, "no_contact")):
        sensor.take(message(time_s, state=name))
    assert [point[8] for point in sensor.points] == [0, 1, None, 2]
    sensor.take(message(1.0, state="no_contact"))
    assert [point[8] for point in sensor.points] == [3]
    assert sensor.past(3) is not None


def test_points_and_images_older_than_ten_minutes_are_removed() -> None:
    sensor = filled(HISTORY_S + 60.0)
    assert sensor.points[0][0] == pytest.approx(60.0, abs=0.15)
    assert len(sensor.points) == pytest.approx(10 * HISTORY_S, abs=1)
    assert len(sensor.pictures) == pytest.approx(5 * HISTORY_S, abs=2), "5 per second"
    times_s = [time_s for time_s, _ in sensor.pictures]
    assert {round(b - a, 3) for a, b in pairwise(times_s)} == {0.2}
    numbers = [point[8] for point in sensor.points if point[8] is not None]
    assert sensor.past(sensor.forgotten - 1) is None
    for number, point in (
        (number, next(p for p in sensor.points if p[8] == number)) for number in numbers[::99]
    ):
        record = sensor.past(number)
        assert record is not None
        assert unpacked(record) == ({"t_s": point[0], "outline": [[1, 2]]}, JPEG)
    assert sensor.past(numbers[-1] + 1) is None


@pytest.mark.heavy
def test_fast_sensors_and_large_images_keep_less_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state, "KEPT_PICTURE_BYTES", 10_000)
    sensor = filled(20.0, jpeg=bytes(1000))
    assert 8 <= len(sensor.pictures) <= 10
    assert sensor.picture_bytes == sum(len(record) for _, record in sensor.pictures) <= 10_000
    assert len(filled(50.0, 1000.0).points) == state.KEPT_FRAMES


def test_clock_that_is_set_back_begins_a_new_history() -> None:
    sensor = filled(20.0)
    sensor.take(message(3.0))
    assert [point[0] for point in sensor.points] == [3.0]
    assert len(sensor.pictures) == 1
    assert sensor.past(sensor.points[0][8]) is not None
    assert sensor.past(0) is None


def test_past_image_of_an_unknown_name_or_number_is_none() -> None:
    shown = WatchState(Progress("a", "", 0, 0), lambda: [])
    shown.history.take(message(1.0))
    assert shown.past("D1", "0") is not None
    for name, number in (("D2", "0"), ("D1", "1"), ("D1", "-1"), ("D1", ""), ("D1", "0x0"), ("D1", "\u00b2"),
                         ("D1", "9" * 30), ("", "0"), ("D1", "0.0")):  # fmt: skip
        assert shown.past(name, number) is None, (name, number)


def test_browser_gets_a_long_history_in_several_records(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state, "SENT_POINTS", 70)
    came = [message(number / 10) for number in range(200)]
    shown = WatchState(Progress("a", "", 0, 0), lambda: [came.pop(0) for _ in range(len(came))])
    news, got = StateNews(shown), list[float]()
    for expected in (70, 70, 60, 0):
        data = news()
        points = unpacked(data)[0]["sensors"][0]["points"] if data else []
        assert len(points) == expected
        got += [point[0] for point in points]
    assert got == [number / 10 for number in range(200)]
    came.append(message(20.0))
    record, picture = unpacked(news())
    assert [point[0] for point in record["sensors"][0]["points"]] == [20.0]
    assert picture == JPEG
    assert "events" not in record, "they have not changed"


def texts(history: History) -> list[tuple[str, float, int]]:
    return [(event["text"], event["t_s"], event["count"]) for event in history.events]


def test_events_follow_from_the_readings() -> None:
    history, taken = History(), {"background": "taken at 10:00:00"}
    for values in (
        {"time_s": 0.0, "state": "taking the background"},
        {"time_s": 1.0, "state": "no_contact", **taken},
        {"time_s": 2.0, **taken},
        {"time_s": 2.3, **taken, "zero_s": 2.2},
        {"time_s": 5.0, **taken, "zero_s": 2.2, "slip": True},
        {"time_s": 5.1, **taken, "zero_s": 2.2, "slip": True, "dropped": 2},
        {"time_s": 5.4, **taken, "zero_s": 2.2, "dropped": 5},
        {"time_s": 7.0, **taken, "zero_s": 2.2, "dropped": 6, "state": "no_contact"},
    ):
        history.take(message(**values))
        history.take(message(**{**values, "sensor": OBJECT}))
    assert texts(history) == [
        ("background taken at 10:00:00", 1.0, 1),
        ("contact", 2.0, 1),
        ("zero", 2.2, 1),
        ("slip", 5.0, 1),
        ("contact ended", 7.0, 1),
    ]
    assert {event["sensor"] for event in history.events} == {"D1"}, "the object repeats its sensors' events"


@pytest.mark.parametrize("unknown", ["frozen", NO_FRAMES])
def test_contact_does_not_end_while_the_sensor_shows_no_new_picture(unknown: str) -> None:
    history = History()
    states = ["no_contact", "tracking", unknown, unknown, "tracking", "no_contact", unknown, "no_contact"]
    for number, name in enumerate(states):
        history.take(message(2.0 * number, state=name))
    assert texts(history) == [
        ("contact", 2.0, 1),
        (unknown, 4.0, 1),
        ("contact ended", 10.0, 1),
        (unknown, 12.0, 1),
    ]


def test_list_of_events_is_bounded() -> None:
    history = History()
    for number in range(KEPT_EVENTS + 50):
        history.add_event(f"mark {number}", float(number))
    assert len(history.events) == KEPT_EVENTS
    assert history.events[0]["text"] == "mark 50"


def test_notice_ends_where_sensors_have_a_next_step() -> None:
    came = [Message("notice", {"text": "background taken"}, b"")]
    shown = WatchState(Progress("a", "", 0, 0), lambda: [came.pop() for _ in range(len(came))])
    assert shown.values()["notice"] == "background taken"
    shown.noticed_s -= NOTICE_S
    assert shown.values()["notice"] == "background taken", "without a sensor nothing replaces it"
    shown.history.take(message(1.0))
    assert shown.values()["notice"] == "", "a page that is opened now shows the next step"


def test_states_with_contact_are_those_of_the_estimators() -> None:
    assert set(state.WITH_CONTACT) == {one.value for one in State} - {State.NO_CONTACT, State.FROZEN}


@pytest.mark.heavy
def test_stored_clip_has_the_angles_of_rig_estimate(tmp_path: Path) -> None:
    write_desk_clip(clip := tmp_path / "clip", 7.0)
    done = Estimation(choose_estimator("ellipse")).of_series(read_frames(clip))
    history = stored_history([done], None, clip)
    assert history.began_s == 0.0
    (sensor,) = history.sensors.values()
    assert [point[0] for point in sensor.points] == pytest.approx(
        [time.time_ns / 1e9 for time in done.estimate.times], abs=1e-6
    )
    shown = [np.nan if point[1] is None else point[1] for point in sensor.points]
    angles = [np.nan if s.angle_deg is None else s.angle_deg for s in done.estimate.samples]
    assert np.isfinite(angles).sum() > 60
    np.testing.assert_allclose(shown, angles, atol=6e-4)
    assert len(sensor.pictures) == 25 + 1, "5 per second, and that of the contact's first frame"
    record, picture = unpacked(sensor.pictures[-1][1])
    assert len(record["outline"]) > 10
    assert picture.startswith(b"\xff\xd8")
    found = {text: time_s for text, time_s, _ in texts(history)}
    assert found["mark 1"] == 2.0
    times_s, states = ([point[column] for point in sensor.points] for column in (0, 6))
    assert found["contact"] == times_s[states.index("tracking")]


def test_damaged_marks_of_a_clip_are_named(tmp_path: Path) -> None:
    write_desk_clip(clip := tmp_path / "clip", 2.5)
    done = Estimation(choose_estimator("ellipse")).of_series(read_frames(clip))
    for text in ("time,text\n1,a\n", "time_s,text\nsoon,a\n", "time_s,text\n1,a,b\n", "time_s,text\nnan,a\n"):
        (clip / MARKS).write_text(text)
        with pytest.raises(FormatError, match=MARKS):
            stored_history([done], None, clip)
