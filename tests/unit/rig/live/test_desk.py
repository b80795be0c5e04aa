"""Sensors on a desk: background, reference, angle, fusion, clips and actions of the user."""

from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, InputError
from rig.frames.estimation import Estimation
from rig.frames.series import read_frames
from rig.live.desk import Desk, DeskSettings
from rig.live.desk_sensor import BACKGROUND_FRAMES, DeskSensor, Reading
from rig.live.feed import OBJECT, Inbox, Listener, LiveFeed, Sender
from rig.tactile.estimators import choose_estimator
from support.desk_frames import GivenFrames, desk_digit, desk_frames

CLOCK = SystemClock()
SLIP = choose_estimator("slip")
NO_VIEWER = LiveFeed()


def readings(sensor: DeskSensor, until_s: float, side: int = 1) -> list[Reading]:
    return [sensor.take(frame, CLOCK) for frame in desk_frames(until_s, side)]


@pytest.mark.parametrize("side", [1, -1])
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
    before = next(r for r in shown if r.time_ns > 5_000_000_000)
    assert before.sample is not None
    assert before.sample.angle_deg == pytest.approx(0.0, abs=0.3)
    assert not before.sample.slip
    assert last.fps == pytest.approx(30.0, abs=0.1)
    assert len(last.outline) > 10
    values = last.values()
    assert values["angle_deg"] == last.sample.angle_deg
    assert set(values) >= {"t_s", "angle_deg", "sigma_deg", "state", "rate_deg_s", "latency_ms"}


def test_recorded_clip_is_read_with_its_background_and_times(tmp_path: Path) -> None:
    frames = list(desk_frames(7.0))
    settings = DeskSettings(choose_estimator("ellipse"), clips=tmp_path)
    with Desk([GivenFrames(frames)], settings, Sender(NO_VIEWER)) as desk:
        desk.act("record")
        assert desk.notice == "record: wait until the background is taken"
        taken = 0
        while taken < 40:
            taken += len(desk.step())
        desk.act("record")
        assert desk.recording
        assert desk.notice.startswith(f"recording to {tmp_path}")
        while not desk.ended:
            desk.step()
        assert "all images have been played" in desk.notice
        desk.act("record")
    (clip,) = tmp_path.iterdir()
    series = read_frames(clip)
    recorded = list(series)
    assert len(recorded) == len(frames) - taken
    assert [f.image is not None and f.image.shape for f in recorded] == [(320, 240, 3)] * len(recorded)
    assert np.array_equal(recorded[-1].image, frames[-1].image), "as the estimator saw it"  # type: ignore[arg-type]
    times = [f.time.time_ns for f in recorded]
    assert times[0] == 0
    assert times == sorted(times)
    done = Estimation(choose_estimator("ellipse")).of_series(series)
    assert done.background == "background: the set's own"
    assert done.figures.answered > 0.5 * len(recorded)


@pytest.mark.slow
def test_two_sensors_give_one_angle() -> None:
    pairs = {f"D{side}": list(desk_frames(7.5, side)) for side in (1, -1)}
    sources = [GivenFrames(frames, name) for name, frames in pairs.items()]
    found: list[Reading] = []
    with Desk(sources, DeskSettings(SLIP), Sender(NO_VIEWER)) as desk:
        while not desk.ended:
            found += [reading for reading in desk.step() if reading.name == OBJECT]
    last = found[-1].sample
    truth = desk_digit().turn_deg(list(desk_frames(7.5))[-1].time_ns)
    assert truth is not None
    assert last is not None
    assert last.angle_deg == pytest.approx(truth, abs=2.0)
    assert last.sigma_deg is not None


def test_user_can_set_reference_background_and_estimator() -> None:
    frames = list(desk_frames(5.5))
    with Desk([GivenFrames(frames)], DeskSettings(SLIP), Sender(NO_VIEWER)) as desk:

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
        assert desk.notice == "'explode' is not known: reload the page"
        assert until("tracking").sample is not None
        desk.act("reference")
        assert desk.notice == "reference taken: the angle counts from here"
        desk.act("background")
        assert until("taking the background").sample is None


def test_frame_with_picture_and_outline_reaches_viewers(tmp_path: Path) -> None:
    inbox = Inbox(str(tmp_path / "viewer"))
    sender = Sender(LiveFeed((Listener(inbox.address, pictures=True),)))
    with Desk(
        [GivenFrames(list(desk_frames(4.0)))], DeskSettings(choose_estimator("ellipse")), sender
    ) as desk:
        while not desk.ended:
            desk.step()
    inbox.close()
    sender.close()
    messages = [message for message in inbox.take() if message.kind == "sensor"]
    assert messages[-1].picture.startswith(b"\xff\xd8")
    assert messages[-1].values["state"] == "tracking"
    assert len(messages[-1].values["outline"]) > 10


def test_source_that_cannot_be_opened_leaves_none_open() -> None:
    class Broken(GivenFrames):
        def connect(self) -> None:
            raise DeviceError("BROKEN: the connection was refused")

    good = GivenFrames([])
    with (
        pytest.raises(DeviceError, match="connection was refused"),
        Desk([good, Broken([], "BROKEN")], DeskSettings(SLIP), Sender(NO_VIEWER)),
    ):
        pass
    assert not good.connected


def test_background_of_another_size_is_rejected() -> None:
    sensor = DeskSensor("D", SLIP, 1, np.zeros((240, 320, 3), np.uint8), None)
    with pytest.raises(InputError, match="use one size"):
        readings(sensor, 2.1)
