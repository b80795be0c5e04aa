"""The sources that `rig live` opens for each argument, and errors with the remedy."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.clock import NS_PER_S, SystemClock
from drivers.errors import DeviceError, InputError, RigError
from drivers.images import encode_jpeg, encode_png
from drivers.interfaces import FrameSource
from drivers.types import Frame
from drivers.video.digit import Digit
from drivers.video.external_camera import GEL_PX, RAW_PX, ExternalCamera, GelSightMini, crop_gel
from drivers.video.v4l2 import VideoNode
from fakes.devices.desk import DeskDigit
from rig.bench import live_source
from rig.bench.live_source import StoredClip, live_sources, serial_of
from rig.frames.clips import BACKGROUND, FRAMES, TIMES
from rig.frames.series import read_frames


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def plug(*nodes: VideoNode) -> None:
        monkeypatch.setattr(live_source, "list_video_nodes", lambda: list(nodes))

    return plug


def test_address_is_read_at_the_rate_of_its_frames() -> None:
    address = "http://127.0.0.1:9/stream.mjpg"
    (camera,), (digit,) = live_sources([address], None, None), live_sources([address], "digit", 30.0)
    assert isinstance(camera, ExternalCamera)
    assert isinstance(digit, Digit)
    assert digit.rate_hz == 30.0


def test_fake_fingertips_see_one_object_from_both_sides() -> None:
    one, other = live_sources(["fake", "fake"], None, None)
    assert isinstance(one, DeskDigit)
    assert isinstance(other, DeskDigit)
    assert one.serial != other.serial
    one.connect()
    frame = one.next_frame(1.0)
    assert frame.image.shape == (320, 240, 3)
    turn = one.turn_deg(frame.time_ns + 8 * 10**9)
    assert turn
    assert other.turn_deg(frame.time_ns + 8 * 10**9) == -turn


def test_demonstration_begins_with_the_first_frame_that_is_read() -> None:
    (fake,) = live_sources(["fake"], None, None)
    assert isinstance(fake, DeskDigit)
    read_ns = SystemClock().now_ns() + 10 * NS_PER_S  # the estimator was compiled meanwhile
    fake.draw(read_ns, np.random.default_rng(0))
    assert fake.turn_deg(read_ns + round(2.9 * NS_PER_S)) is None
    assert fake.turn_deg(read_ns + round(3.1 * NS_PER_S)) == 0.0


def test_serial_and_device_are_a_digit(plugged: Callable[..., None], tmp_path: Path) -> None:
    node = tmp_path / "video2"
    node.touch()
    plugged(VideoNode(str(node), "D20641"))
    (digit,) = live_sources(["D20641"], None, None)
    assert isinstance(digit, Digit)
    assert (digit.serial, digit.rate_hz) == ("D20641", 60.0)
    (mini,) = live_sources(["D20641"], "gelsight-mini", None)
    assert isinstance(mini, GelSightMini)


def test_only_sensors_have_a_serial_for_their_background(
    plugged: Callable[..., None], tmp_path: Path
) -> None:
    plugged(
        VideoNode("/dev/video2", "MINI7"), VideoNode("/dev/video4", "SAME"), VideoNode("/dev/video6", "SAME")
    )
    assert [serial_of(text) for text in ("D20641", "/dev/video2", "2")] == ["D20641", "MINI7", "MINI7"]
    others = "fake", "http://127.0.0.1:9/x", "/dev/video4", "/dev/video9", str(tmp_path)
    assert [serial_of(text) for text in others] == [None] * len(others)


@pytest.mark.parametrize(
    ("text", "kind", "match"),
    [
        ("D1", InputError, "no video devices have this serial; found: D20641 at .*video2"),
        ("0", DeviceError, r"/dev/video0: there is no such device \(found: none\)"),
        ("/dev/video7", DeviceError, "there is no such device"),
        ("nothing.avi", InputError, "no such file or folder: give a DIGIT's serial"),
        ("http://:9", InputError, "not an address of the form"),
    ],
)
def test_missing_source_is_rejected_with_the_cure(
    text: str, kind: type[RigError], match: str, plugged: Callable[..., None]
) -> None:
    plugged(VideoNode("/dev/video2", "D20641"))
    with pytest.raises(kind, match=match):
        live_sources([text], None, None)


def test_unreadable_device_names_the_group(
    monkeypatch: pytest.MonkeyPatch, plugged: Callable[..., None], tmp_path: Path
) -> None:
    (tmp_path / "video2").touch()
    monkeypatch.setattr(live_source.os, "access", lambda *_: False)
    plugged(VideoNode(str(tmp_path / "video2"), "D20641"))
    with pytest.raises(DeviceError, match="join the group 'video'"):
        live_sources(["D20641"], None, None)


def video(path: Path, width: int, height: int) -> str:
    """A grey video of three frames at 25 Hz."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (width, height))
    for _ in range(3):
        writer.write(np.full((height, width, 3), 90, np.uint8))
    writer.release()
    return str(path)


def stored_source(path: Path, sensor: str | None = None, fps: float | None = None) -> StoredClip:
    (source,) = live_sources([str(path)], sensor, fps, {str(path): read_frames(path, fps=fps)})
    assert isinstance(source, StoredClip)
    return source


def test_clip_is_played_at_its_own_times_without_its_background(tmp_path: Path) -> None:
    clip = tmp_path / "pen_2"
    (clip / FRAMES).mkdir(parents=True)
    times_s = [3.0, 3.02, 3.04, 3.14]
    for name, grey in ((BACKGROUND, 0), *((f"{FRAMES}/{i}", 200 + i) for i in range(4))):
        (clip / f"{name}.png").write_bytes(encode_png(np.full((48, 64, 3), grey, np.uint8)))
    (clip / TIMES).write_text("\n".join(["frame,t_s", *(f"{i},{t}" for i, t in enumerate(times_s))]))
    source = stored_source(clip)
    source.connect()
    frames = [source.next_frame(5.0) for _ in times_s]
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [200, 201, 202, 203]
    since_s = [(frame.time_ns - frames[0].time_ns) / NS_PER_S for frame in frames]
    assert since_s == pytest.approx([0.0, 0.02, 0.04, 0.14])
    with pytest.raises(DeviceError, match="all 4 images have been played"):
        source.next_frame(5.0)
    assert (source.serial, source.rate_hz, source.counters()["dropped"]) == ("pen_2", pytest.approx(50.0), 0)
    source.disconnect()
    assert stored_source(clip, fps=10.0).rate_hz == pytest.approx(10.0)
    with pytest.raises(InputError, match="named twice"):
        live_sources([str(clip)] * 2, None, None, {str(clip): read_frames(clip)})


def test_frames_of_a_gelsight_mini_are_cropped_to_the_gel(tmp_path: Path) -> None:
    source = stored_source(Path(video(tmp_path / "mini.avi", 640, 480)), "gelsight-mini")
    raw = np.zeros((RAW_PX[1], RAW_PX[0], 3), np.uint8)
    raw[400:-400, 540:-540] = (200, 60, 20)
    (tmp_path / "1.jpg").write_bytes(encode_jpeg(raw, 90))
    of_video, full = (first_frame(each) for each in (source, GelSightMini("M", str(tmp_path), 25.0)))
    assert of_video.image.shape == full.image.shape == (GEL_PX[1], GEL_PX[0], 3)
    assert (of_video.serial, source.rate_hz) == ("mini.avi", 25.0)
    assert np.abs(full.image[20:-20, 20:-20].astype(int) - (200, 60, 20)).max() <= 4, "red stays red"
    assert full.image[0, 0].max() <= 4, "dark where the border of 0.15 ends"
    image = np.zeros((480, 640, 3), np.uint8)
    image[72:408, 96:544] = 200
    cropped = crop_gel(image)
    assert cropped.shape == (GEL_PX[1], GEL_PX[0], 3)
    assert cropped.min() == 200
    assert crop_gel(cropped) is cropped, "published frames are cropped already"


def first_frame(source: FrameSource) -> Frame:
    source.connect()
    frame = source.next_frame(5.0)
    source.disconnect()
    return frame
