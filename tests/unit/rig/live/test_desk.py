"""Sensors on a desk: background, reference, angle, fusion, clips and actions of the user."""

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.clock import NS_PER_S, SystemClock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError
from drivers.images import decode_stored
from drivers.types import Frame, Image
from rig.frames.estimates import Estimation
from rig.frames.series import read_frames
from rig.lift.object_angle import TipTrack
from rig.live.desk import Desk, DeskSettings, FusedObject
from rig.live.desk_sensor import DeskSensor, Reading
from rig.live.feed import NO_FRAMES, OBJECT, Inbox, Listener, Sender
from rig.live.sensor_background import (
    BACKGROUND_FRAMES,
    SensorBackground,
    store_background,
    stored_background,
)
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State
from support.desk_frames import GivenFrames, desk_digit, desk_frames
from support.marks import heavy

CLOCK = SystemClock()
SLIP, ELLIPSE = choose_estimator("slip"), choose_estimator("ellipse")
TAKEN = "background taken"
DOUBT = "this background looks like a contact: lift the object, press Take background"


def readings(sensor: DeskSensor, until_s: float, side: int = 1) -> list[Reading]:
    return [sensor.take(frame, CLOCK) for frame in desk_frames(until_s, side)]


@pytest.mark.heavy
@pytest.mark.parametrize("side", [-1, *heavy(1)])
def test_angle_follows_the_object_from_the_moment_the_contact_has_settled(side: int) -> None:
    shown = readings(DeskSensor("D", SLIP, side, None, None), 8.0, side)
    assert [r.state for r in shown[:BACKGROUND_FRAMES]] == ["taking the background"] * BACKGROUND_FRAMES
    assert shown[BACKGROUND_FRAMES].state == "no_contact"
    last = shown[-1]
    truth = desk_digit(side).turn_deg(last.time_ns)
    assert truth is not None
    assert abs(truth) > 7.0
    assert last.sample is not None
    assert last.sample.angle_deg == pytest.approx(side * truth, abs=1.5)
    assert all(r.sample is not None and r.sample.slip for r in shown if 6.2e9 < r.time_ns < 7.0e9)
    assert not last.sample.slip, "it has come to rest"
    assert last.slips_s == pytest.approx([6.0], abs=0.15), "the event is kept"
    assert shown[BACKGROUND_FRAMES].zero_s is None
    assert last.zero_s is not None
    assert 3.0 < last.zero_s < 5.0
    assert {r.zero_s for r in shown} == {None, last.zero_s}, "one reference for this contact"
    before = next(r for r in shown if r.time_ns > 5_000_000_000)
    assert before.sample is not None
    assert before.sample.angle_deg == pytest.approx(0.0, abs=0.3)
    assert not before.sample.slip
    assert last.fps == pytest.approx(30.0, abs=0.1)
    assert len(last.outline) > 10
    values = last.values()
    assert values["angle_deg"] == last.sample.angle_deg
    assert set(values) >= {"t_s", "angle_deg", "sigma_deg", "state", "rate_deg_s", "latency_ms"}


def test_frames_are_shown_while_the_estimator_is_prepared() -> None:
    sensor = DeskSensor("D", ELLIPSE, 1, None, None)
    sensor.wait_until(lambda: sensor._tally.frames > BACKGROUND_FRAMES + 2)
    shown = readings(sensor, 2.8)
    states = [r.state for r in shown[BACKGROUND_FRAMES : BACKGROUND_FRAMES + 3]]
    assert states == ["preparing the estimator"] * 2 + ["no_contact"]
    assert all(r.frame is not None for r in shown)


@pytest.mark.heavy
@pytest.mark.parametrize("with_jpeg", [True, *heavy(False)])
def test_clip_has_the_frames_unchanged_and_gives_the_angles_of_the_live_view(
    tmp_path: Path, with_jpeg: bool
) -> None:
    frames = [frame if with_jpeg else replace(frame, jpeg=None) for frame in desk_frames(8.0)]
    live: list[Reading] = []
    settings = DeskSettings(SLIP, clips=tmp_path, simulated=True)
    with Desk([GivenFrames(frames)], settings, Sender()) as desk:
        desk.act("record")
        assert desk.notice == "record: wait until the background is taken"
        while len(live) < BACKGROUND_FRAMES:
            live += desk.step()
        desk.act("record")
        assert desk.clips.is_recording
        assert desk.notice.startswith(f"recording to {tmp_path}")
        while not desk.has_ended:
            live += desk.step()
    answered = sum(r.sample is not None and r.sample.angle_deg is not None for r in live)
    counts = f"{answered} of 180 frames with an angle; without: (.*); 0 dropped"
    said = re.search(f"all images have been played; .*; {counts}", desk.notice)
    assert said is not None
    assert "15 taking the background" in said[1]
    assert answered + sum(int(count) for count in re.findall(r"\d+", said[1])) == 180
    (clip,) = tmp_path.iterdir()
    assert {file.suffix for file in (clip / "frames").iterdir()} == {".jpg" if with_jpeg else ".png"}
    series = read_frames(clip)
    assert series.simulated
    assert "SIMULATED frames" in series.notes
    recorded = list(series.read())
    assert np.array_equal([f.image for f in recorded], [frame.image for frame in frames[BACKGROUND_FRAMES:]])
    times = [f.time.time_ns for f in recorded]
    assert times == [
        frame.time_ns - frames[BACKGROUND_FRAMES].time_ns for frame in frames[BACKGROUND_FRAMES:]
    ]
    done = Estimation(SLIP).of_series(series)
    assert done.background == "background: the set's own"
    again = [sample.angle_deg for sample in done.estimate.samples]
    seen = [None if r.sample is None else r.sample.angle_deg for r in live[BACKGROUND_FRAMES:]]
    assert [a is None for a in again] == [a is None for a in seen]
    turns = [s - a for s, a in zip(seen, again, strict=True) if s is not None and a is not None]
    assert len(turns) > 60
    assert np.ptp(turns[-40:]) < 1e-4, "the same angles, but for the zero and single precision"


class Unplugged(GivenFrames):
    """After its last frame no further ones arrive."""

    def next_frame(self, timeout_s: float) -> Frame:
        if not self._frames:
            raise DeviceTimeoutError(f"{self.serial}: no frame within 1 s")
        return super().next_frame(timeout_s)


def test_time_of_the_object_does_not_go_back_when_frames_arrive_out_of_order() -> None:
    def sensor(time_ns: int) -> Any:
        track = TipTrack(1, [SlipSample(time_ns, State.NO_CONTACT)])
        stream = SimpleNamespace(track=track, slips_s=())
        return SimpleNamespace(stream=stream, zero_s=None, slip=False, dropped=0)

    fused = FusedObject({"D1": sensor(2_000), "D2": sensor(1_900)}, CLOCK)
    for name, time_ns in (("D1", 2_000), ("D2", 1_900)):
        sample = SlipSample(time_ns, State.NO_CONTACT)
        reading = fused.update(Reading(name, time_ns, "no_contact", sample))
        assert reading is not None
        assert reading.time_ns == 2_000, "a time that goes back clears the history of the page"


@pytest.mark.heavy
def test_slip_alarm_of_the_object_ends_with_the_sensor_that_raised_it_and_its_angle_with_both() -> None:
    untouched = list(desk_frames(2.9))
    other = [
        replace(untouched[n % len(untouched)], time_ns=untouched[0].time_ns + n * NS_PER_S // 30, sequence=n)
        for n in range(300)
    ]
    sources = [Unplugged(list(desk_frames(6.6)), "D1"), Unplugged(other, "D2")]
    found: list[Reading] = []
    with Desk(sources, DeskSettings(SLIP), Sender()) as desk:
        while not (found and found[-1].state == NO_FRAMES):
            found += desk.step()
        silent, slips = found[-1], [r.sample.slip for r in found if r.name == OBJECT and r.sample]
        assert slips[-1], "the object slips when the sensor is unplugged"
        after = [r for _ in range(20) for r in desk.step()]
        last = after
        while last[-1].state != NO_FRAMES:
            last = desk.step() or last
    assert (silent.name, silent.sample, silent.frame) == ("D1", None, None)
    assert silent.line().startswith("D1: angle     -    , no frames")
    assert [r.state for r in after if r.name == "D1"] == [], "it is reported once"
    slips = [r.sample.slip for r in after if r.name == OBJECT and r.sample]
    assert slips
    assert not any(slips)
    assert [(r.name, r.state, r.sample) for r in last] == [(n, NO_FRAMES, None) for n in ("D2", OBJECT)]


@pytest.mark.heavy
def test_two_sensors_give_one_angle() -> None:
    pairs = {f"D{side}": list(desk_frames(7.5, side)) for side in (1, -1)}
    sources = [GivenFrames(frames, name) for name, frames in pairs.items()]
    found: list[Reading] = []
    with Desk(sources, DeskSettings(SLIP), Sender()) as desk:
        while not desk.has_ended:
            found += [reading for reading in desk.step() if reading.name == OBJECT]
    last = found[-1].sample
    truth = desk_digit().turn_deg(list(desk_frames(7.5))[-1].time_ns)
    assert truth is not None
    assert last is not None
    assert last.angle_deg == pytest.approx(truth, abs=2.0)
    assert last.sigma_deg is not None


@pytest.mark.heavy
def test_user_can_set_reference_background_and_estimator() -> None:
    frames = list(desk_frames(5.5))
    with Desk([GivenFrames(frames)], DeskSettings(SLIP), Sender()) as desk:

        def until(state: str) -> Reading:
            while True:
                for reading in desk.step():
                    if reading.state == state:
                        return reading

        desk.act("reference")
        assert desk.notice == "reference: wait until the background is taken"
        until("no_contact")
        desk.act("reference")
        assert "press an object on the gel" in desk.notice
        until("tracking")
        desk.act("estimator ellipse")
        assert desk.notice == "estimator ellipse"
        for wrong in ("estimator nothing", "estimator toskov", "explode"):
            desk.act(wrong)
            assert desk.notice != "estimator ellipse"
        assert desk.notice == "'explode' is not known: reload the page"
        assert until("tracking").sample is not None
        desk.act("reference")
        assert desk.notice == "reference taken: the angle counts from here"
        desk.act("background")
        assert until("taking the background").sample is None


BROKEN = """
from pathlib import Path
Path("imported").touch()
class Move:
    def __init__(self, background): raise RuntimeError("moved")
    def update(self, image, time_ns): ...
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a module of an estimator that cannot be made."""
    (tmp_path / "broken_tip.py").write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.heavy
@pytest.mark.parametrize("collecting", [True, False])
def test_estimator_that_is_not_offered_or_cannot_be_made_is_refused_and_the_view_goes_on(
    lab: Path, collecting: bool
) -> None:
    offered = ("ellipse", "broken_tip:Move", "builtins:dict")
    settings = DeskSettings(ELLIPSE, clips=lab / "clips", estimators=offered)
    with Desk([GivenFrames(list(desk_frames(5.5)))], settings, Sender()) as desk:
        while not collecting and not desk.clips.is_recording:
            desk.step()
            desk.act("record")
        for name in ("broken_tip:Other", "os:system", "", "ellipse ", " ellipse", "ELLIPSE"):
            desk.act(f"estimator {name}")
            assert desk.notice == f"'estimator {name}' is not known: reload the page"
        assert not (lab / "imported").exists()
        for name, cause in (("broken_tip:Move", "moved"), ("builtins:dict", "dict(background)")):
            desk.act(f"estimator {name}")
            assert name in desk.notice
            assert cause in desk.notice
            assert desk.step()
        assert desk.clips.is_recording is not collecting
        states = {reading.state for _ in range(60) for reading in desk.step()}
        assert states >= {"no_contact"}


@contextmanager
def with_page(tmp_path: Path, frames: Iterable[Frame], clips: Path) -> Iterator[tuple[Desk, Inbox]]:
    """Yield a desk and the inbox of the page that shows it."""
    inbox = Inbox(str(tmp_path / "viewer"))
    sender = Sender([Listener(inbox.address, pictures=True)])
    with Desk([GivenFrames(list(frames))], DeskSettings(ELLIPSE, clips=clips), sender) as desk:
        yield desk, inbox
    inbox.close()
    sender.close()


def test_frame_with_picture_and_outline_reaches_viewers(tmp_path: Path) -> None:
    with with_page(tmp_path, desk_frames(4.0), tmp_path) as (desk, inbox):
        while not desk.has_ended:
            desk.step()
    messages = [message for message in inbox.take() if message.kind == "sensor"]
    assert messages[-1].picture.startswith(b"\xff\xd8")
    assert messages[-1].values["state"] == "tracking"
    assert len(messages[-1].values["outline"]) > 10


def test_saved_clips_are_named_when_the_desk_is_closed(tmp_path: Path) -> None:
    with with_page(tmp_path, desk_frames(3.0), tmp_path / "clips") as (desk, _):
        desk.act("save")
        assert desk.notice == "save: wait until the background is taken"
        while not any(reading.sample is not None for reading in desk.step()):
            pass
        desk.act("save")
        assert desk.notice == "saving the last 30 s"
    (clip,) = (tmp_path / "clips").iterdir()
    assert desk.notice == f"saved {clip}: {BACKGROUND_FRAMES + 1} frames, 0.5 s"


def test_marks_are_numbered_and_reach_the_page(tmp_path: Path) -> None:
    with with_page(tmp_path, desk_frames(2.1), tmp_path) as (desk, inbox):
        for action, notice in (
            ("mark 12.500", "mark 1"),
            ("mark", "'mark' is not known: reload the page"),
            ("mark x", "'mark x' is not known: reload the page"),
            ("mark 13.000", "mark 2"),
        ):
            desk.act(action)
            assert desk.notice == notice
    found = [message.values for message in inbox.take() if message.kind == "mark"]
    assert found == [{"t_s": 12.5, "text": "mark 1"}, {"t_s": 13.0, "text": "mark 2"}]


def test_source_that_cannot_be_opened_leaves_none_open() -> None:
    class Broken(GivenFrames):
        def connect(self) -> None:
            raise DeviceError("BROKEN: the connection was refused")

    good = GivenFrames([])
    with (
        pytest.raises(DeviceError, match="connection was refused"),
        Desk([good, Broken([], "BROKEN")], DeskSettings(SLIP), Sender()),
    ):
        pass
    assert not good.connected


@pytest.fixture
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


def notices(background: SensorBackground, frames: Iterable[Frame]) -> list[str]:
    """Return the news about a background in frames."""
    return [news for frame in frames if (news := background.add(frame))]


def pressed() -> list[Frame]:
    """Frames of a contact at rest, after those of `released`."""
    return list(desk_frames(21.0, from_s=20.0))


def released() -> list[Frame]:
    """Frames without contact, between two contacts."""
    return list(desk_frames(17.5, from_s=16.0))


def weak() -> Image:
    """A frame with a contact that is seen only when it is lifted off."""
    return (0.75 * released()[0].image + 0.25 * pressed()[0].image).astype(np.uint8)


@pytest.mark.heavy
def test_background_taken_during_a_contact_is_named_until_it_is_taken_again() -> None:
    sensor = DeskSensor("D", ELLIPSE, 1, None, None)
    assert notices(sensor.background, pressed()) == [f"background taken; {DOUBT}"]
    assert sensor.take(released()[0], CLOCK).values()["doubt"] == DOUBT
    sensor.take_background()
    assert notices(sensor.background, released()) == [TAKEN]
    assert sensor.take(pressed()[0], CLOCK).doubt == ""


@pytest.mark.heavy
def test_given_background_with_a_weak_contact_is_named_when_the_object_is_lifted() -> None:
    background = SensorBackground(weak(), None, "begin again")
    assert background.doubt == ""
    assert notices(background, released()) == ["this background looks like a contact: begin again"]


@pytest.mark.heavy
def test_background_is_stored_for_its_serial_and_used_at_the_next_start(state_home: Path) -> None:
    first = notices(SensorBackground(None, "D20001"), released())
    assert first == ["background taken and stored for serial D20001"]
    stored = state_home / "visuotactile-slip-rig/backgrounds/D20001.png"
    taken = datetime(2026, 11, 26, 10, 12).timestamp()
    os.utime(stored, (taken, taken))
    again = SensorBackground(None, "D20001")
    (news,) = notices(again, released())
    assert re.fullmatch(
        r"background of serial D20001 from 2026-11-26 10:12 is used: gel unchanged "
        r"\(light [+-]0 %, gel [0-3] %\)",
        news,
    )
    assert again.origin == "of serial D20001, from 2026-11-26 10:12"
    on_the_gel = SensorBackground(None, "D20001")
    (news,) = notices(on_the_gel, pressed())
    assert "from 2026-11-26 10:12 is used: something touches the gel (light" in news
    assert on_the_gel.doubt == ""
    for used in (again, on_the_gel):
        assert np.array_equal(used.image, decode_stored(stored.read_bytes()))


@pytest.mark.heavy
@pytest.mark.usefixtures("state_home")
def test_outdated_or_doubtful_stored_background_is_replaced() -> None:
    store_background("D20001", pressed()[0].image)
    (news,) = notices(SensorBackground(None, "D20001"), released())
    name = r"the gel has changed since the background of serial D20001 from .*"
    assert re.match(rf"{name} \(light .* %, gel \d+ %\): a new background was taken and stored", news)
    assert stored_background("D20001") is not None
    faint = weak()
    store_background("D20001", faint)
    held = [replace(frame, image=faint) for frame in pressed()]
    news_of_weak = notices(SensorBackground(None, "D20001"), [*held, *released()])
    assert len(news_of_weak) == 2, "it is used, then doubted"
    assert stored_background("D20001") is None, "not offered again"
    notices(SensorBackground(None, "D20001"), pressed())
    assert stored_background("D20001") is None, "a contact is not stored"


@pytest.mark.heavy
def test_backgrounds_of_similar_serials_differ_and_one_that_cannot_be_stored_is_used(
    state_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for one, other in (("left/1", "left_1"), ("D 1", "D_1"), ("D:2", "D_2")):
        store_background(one, released()[0].image)
        assert stored_background(other) is None
        assert stored_background(one) is not None
    (state_home / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(state_home / "file"))
    background = SensorBackground(None, "D20001")
    (news,) = notices(background, released())
    assert "background taken (not stored: " in news
    assert background.image is not None


def test_source_named_as_the_fused_angle_and_background_of_another_size_are_refused() -> None:
    sources = [GivenFrames([], "D20001"), GivenFrames([], OBJECT)]
    with pytest.raises(InputError, match="source 'object'"):
        Desk(sources, DeskSettings(SLIP), Sender())
    with pytest.raises(InputError, match="use one size"):
        readings(DeskSensor("D", ELLIPSE, 1, np.zeros((240, 320, 3), np.uint8), None), 2.1)
