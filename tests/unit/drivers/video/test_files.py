"""Recorded frames through the camera driver: bit-exact, at the clock's rate, with correct age."""

import threading
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError, StaleFrameError
from drivers.images import encode_jpeg, encode_png
from drivers.types import Frame
from drivers.video import reader
from drivers.video.digit import Digit
from drivers.video.external_camera import ExternalCamera
from drivers.video.files import image_files
from fakes.clock import SimulatedClock
from support.connected import connected
from support.frame_files import write_folder, write_video
from support.waiting import until

RATE_HZ = 100.0


def drawn(time_ns: int) -> np.ndarray:
    """A different picture for each time, 64 x 48."""
    return np.random.default_rng(time_ns).integers(0, 256, (48, 64, 3), dtype=np.uint8)


IMAGES = [drawn(round(number * 1e9 / RATE_HZ)) for number in range(40)]


@pytest.fixture(params=["folder", "video"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "folder":
        write_folder(tmp_path, drawn, RATE_HZ, len(IMAGES))
        return tmp_path
    write_video(tmp_path / "frames.avi", drawn, RATE_HZ, len(IMAGES))
    return tmp_path / "frames.avi"


@pytest.fixture
def camera(recording: Path):
    with connected(ExternalCamera("C1", str(recording), RATE_HZ, (64, 48))) as camera:
        yield camera


def test_frames_equal_the_files_at_the_requested_rate_until_the_end(camera: ExternalCamera) -> None:
    frames = [camera.next_frame(1.0) for _ in IMAGES]
    assert frames[-1].time_ns <= SystemClock().now_ns()
    assert [frame.sequence for frame in frames] == list(range(len(IMAGES)))
    assert all(np.array_equal(frame.image, image) for frame, image in zip(frames, IMAGES, strict=True))
    assert set(np.diff([frame.time_ns for frame in frames])) == {10_000_000}
    assert camera.time_kind == "schedule"
    with pytest.raises(DeviceError, match="all 40 images have been played"):
        camera.next_frame(1.0)
    camera.connect()
    assert camera.next_frame(1.0).image.shape == (48, 64, 3)


def test_file_waits_for_a_late_reader(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "BACKLOG_S", 5 / RATE_HZ)
    camera = ExternalCamera("C1", str(recording), RATE_HZ, (64, 48))
    with pytest.raises(NotConnectedError, match="connect"):
        camera.next_frame(0.1)
    camera.waits = True
    camera.connect()
    until(lambda: camera.counters()["frames"] == 6, 10.0)  # five unread frames, and one that waits for room
    frames = [camera.next_frame(10.0) for _ in IMAGES]
    assert [frame.sequence for frame in frames] == list(range(len(IMAGES)))
    assert set(np.diff([frame.time_ns for frame in frames])) == {10_000_000}
    assert camera.counters()["unread"] == 0
    camera.connect()
    until(lambda: camera.counters()["frames"] == len(IMAGES) + 6, 10.0)
    camera.disconnect()  # also while a frame waits for room
    camera.disconnect()
    with pytest.raises(NotConnectedError, match="connect"):
        camera.newest_frame(0.1)
    until(lambda: "C1" not in {thread.name for thread in threading.enumerate()}, 10.0)


def test_frame_older_than_the_limit_is_refused() -> None:
    clock = SimulatedClock()
    buffer = reader.FrameBuffer("C1", clock, backlog=2)
    with pytest.raises(StaleFrameError, match="no frame received yet"):
        buffer.newest(1.0)
    assert [buffer.put(Frame(IMAGES[0], 0, number, "C1")) for number in range(3)] == [False, False, True]
    assert buffer.next(0.0).sequence == 1, "the oldest unread frame was dropped"
    clock.sleep_until(300_000_000)
    assert buffer.newest(0.31).sequence == 2
    with pytest.raises(DeviceTimeoutError, match="no frame within 0 s"):
        buffer.next(0.0)
    with pytest.raises(
        StaleFrameError, match=r"0\.300 s old, over the limit of 0\.290 s; check that it still"
    ):
        buffer.newest(0.29)


def test_jpeg_files_keep_their_bytes_and_damaged_ones_are_withheld(tmp_path: Path) -> None:
    jpegs = [encode_jpeg(image) for image in IMAGES[:6]]
    for number, jpeg in enumerate(jpegs):
        (tmp_path / f"{number}.jpg").write_bytes(jpeg[:300] if number == 2 else jpeg)
    (tmp_path / "10.png").write_bytes(b"\x89PNG cut short")
    (tmp_path / "notes.txt").write_text("no image")
    with connected(ExternalCamera("C1", str(tmp_path), RATE_HZ)) as camera:
        frames = [camera.next_frame(1.0) for _ in range(5)]
        with pytest.raises(DeviceError, match="all 7 images"):
            camera.next_frame(1.0)
    assert [frame.jpeg for frame in frames] == [jpegs[number] for number in (0, 1, 3, 4, 5)]
    assert [frame.sequence for frame in frames] == [0, 1, 3, 4, 5]
    assert camera.counters()["damaged"] == 2


def test_sideways_files_of_a_digit_are_rotated_upright(tmp_path: Path) -> None:
    write_folder(tmp_path, lambda time_ns: np.ascontiguousarray(drawn(time_ns)), RATE_HZ, 20)
    with connected(Digit("D1", RATE_HZ, (48, 64), str(tmp_path))) as digit:
        frame = digit.next_frame(1.0)
    assert np.array_equal(frame.image, np.rot90(IMAGES[frame.sequence]))


def test_background_beside_the_images_is_not_played(tmp_path: Path) -> None:
    for name in ("1.png", "2.png", "background.png"):
        (tmp_path / name).write_bytes(encode_png(IMAGES[0]))
    assert [file.name for file in image_files(tmp_path)] == ["1.png", "2.png"]
    for name in ("1.png", "2.png"):
        (tmp_path / name).unlink()
    with pytest.raises(InputError, match=r"background\.png is its only image; give the video of the clip"):
        image_files(tmp_path)


def test_invalid_recording_address_is_rejected_first(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"not a film")
    for address, words in (
        (str(tmp_path), "no images in it"),
        (str(tmp_path / "film.mp4"), "not a readable video"),
        (str(tmp_path / "none"), "does not exist"),
        ("rtsp://host/stream", "not an address"),
    ):
        with pytest.raises(InputError, match=words):
            ExternalCamera("C1", address)
