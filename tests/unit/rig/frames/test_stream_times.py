"""What the times of a stream mean: used as they are, replaced with a note, or refused."""

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import rig
from drivers.clock import SystemClock
from drivers.errors import InputError
from drivers.video.files import VideoStream
from rig.frames.series import read_frames
from rig.frames.times import check_times, container_times, spacing_notes, stamped_times
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State
from support.ros_bags import TOPIC, write_bag
from support.videos import write_video

Image = NDArray[np.uint8]
EPOCH_NS = 1_763_000_000 * 10**9
EVEN_NS = np.arange(60) * 16_666_667
# irregular: three frames at 20 ms, then one after 130 ms
UNEVEN_MS = [sum(130 if j % 4 == 3 else 20 for j in range(i)) for i in range(24)]
NUMBERED = [np.full((64, 48, 3), 8 * i, np.uint8) for i in range(24)]


@pytest.mark.parametrize(
    "times_ns", [EVEN_NS, EPOCH_NS + EVEN_NS, -EVEN_NS[::-1], 40 * EVEN_NS, EVEN_NS[:1], EVEN_NS[:0]]
)
def test_usual_times_are_used_without_a_note(times_ns: NDArray[np.int64]) -> None:
    assert check_times("x", times_ns)[1] == ()


@pytest.mark.parametrize(
    ("seconds", "message"),
    [
        (np.zeros(60), "59 of 60 frames have the time of the previous frame"),
        (np.floor(EVEN_NS / 1e9 * 3), "have the time of the previous frame"),
        (np.float32(1.763e9 + EVEN_NS / 1e9), "rounded as float32"),
        (np.repeat(np.arange(20) / 2, [1, 5] * 10), "have the time of the previous frame"),
        (np.r_[EVEN_NS[:30], EVEN_NS[:30]] / 1e9, "frame 30 is 0.483333 s before the previous frame"),
        (np.r_[0.0, 2.0, 1.0, 3.0], "frame 2 is 1 s before"),
        (EVEN_NS / 1e3, "are the times in microseconds"),
        (EVEN_NS / 1e9 / 60 * 4, "are the times in minutes"),
        (EVEN_NS / 1e9 / 3600, "are the times in hours"),
        (np.r_[0.0, 1.763e9 + EVEN_NS / 1e9], "frame 1 is 2.04e\\+04 days after the previous frame"),
        (100.0 * np.arange(20), "0.01 frames per second by their times, 100 s apart: are the times in ms"),
    ],
)
def test_ambiguous_times_are_refused_by_name(seconds: NDArray[np.float64], message: str) -> None:
    with pytest.raises(InputError, match=f"clip: .*{message}"):
        check_times("clip", [round(float(t) * 1e9) for t in seconds])


def test_few_repeated_times_and_frames_far_apart_are_noted() -> None:
    _, (note,) = check_times("x", [0, 10**7, 10**7, 2 * 10**7, 3 * 10**7])
    repeated = "times: 1 frame with the time of the previous frame (first: frame 2): not estimated, 'lost'"
    assert note == repeated
    assert spacing_notes(EVEN_NS) == spacing_notes([]) == []
    assert "16.7 s apart (are the times in ms?)" in spacing_notes(1000 * EVEN_NS)[0]
    gap = spacing_notes(np.r_[EVEN_NS[:30], EVEN_NS[40:]])
    assert gap == ["1 gap between the frames, the longest 0.183 s, 0.483 s after the first frame"]


@pytest.mark.parametrize(
    "shared_ns", [EVEN_NS[3::4].repeat(4), np.round(EVEN_NS / 1e8).astype(np.int64) * 10**8]
)
def test_times_shared_by_regular_bursts_are_spread_with_a_note(shared_ns: NDArray[np.int64]) -> None:
    """Four frames with the time of the read, and times of one decimal."""
    times, (note,) = check_times("x", shared_ns)
    assert np.abs(times - EVEN_NS).max() < 0.06e9
    assert np.diff(times).min() > 0.01e9
    assert np.diff(times).max() < 0.026e9
    assert "frames share one time every 0." in note


@pytest.mark.parametrize("shift", [0, EPOCH_NS])
def test_good_stamps_are_used_and_sorted(shift: int) -> None:
    stamps = shift + EVEN_NS
    swapped = stamps.copy()
    swapped[[10, 12]] = swapped[[12, 10]]
    assert stamped_times("x", (stamps + 1).tolist(), EVEN_NS.tolist())[1] == []
    times, notes = stamped_times("x", (swapped + 1).tolist(), EVEN_NS.tolist())
    assert times.tolist() == (swapped + 1).tolist()
    assert notes == ["times: 2 frames arrived out of order, sorted by stamp"]
    times, (note,) = stamped_times("x", (stamps + 1).tolist(), (2 * EVEN_NS).tolist())
    assert times.tolist() == (stamps + 1).tolist()
    assert "0.983 s by the stamps, which are used, and 1.97 s by the times of receipt" in note


@pytest.mark.parametrize(
    ("stamps_ns", "why"),
    [
        (np.zeros(60, int), "no stamps"),
        (np.full(60, EPOCH_NS), "constant, rounded or not in s"),
        (EPOCH_NS + EVEN_NS // 10**9 * 10**9, "constant, rounded or not in s"),
        (np.r_[EPOCH_NS + EVEN_NS[:30], 1 + EVEN_NS[:30]], "go back"),
        (EPOCH_NS + 10**6 * EVEN_NS, "constant, rounded or not in s"),
        (np.r_[0, EPOCH_NS + EVEN_NS[1:]], "days apart"),
        (np.r_[1 + EVEN_NS[:30], EPOCH_NS + EVEN_NS[30:]], "days apart"),
        (EPOCH_NS + EVEN_NS + np.where(np.arange(60) == 20, 3600 * 10**9, 0), "go back"),
    ],
)
def test_bad_stamps_are_replaced_by_the_times_of_receipt(stamps_ns: NDArray[np.int64], why: str) -> None:
    received = (EPOCH_NS + 5 + EVEN_NS).tolist()
    times, notes = stamped_times("bag", stamps_ns.tolist(), received)
    assert times.tolist() == received
    assert notes[0].startswith("times: of receipt, because the frames have")
    assert why in notes[0]
    with pytest.raises(InputError, match=r"bag, times: of receipt.* have the time of the previous frame"):
        stamped_times("bag", stamps_ns.tolist(), [7] * 60)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
def test_bag_with_swapped_stamps_gives_its_images_in_order_of_capture(tmp_path: Path, storage: str) -> None:
    images = [np.full((8, 8, 3), 20 * i, np.uint8) for i in range(10)]
    order = [0, 2, 1, 3, 6, 4, 5, 7, 9, 8]
    path = write_bag(
        tmp_path / "x.bag", {TOPIC: [images[i] for i in order]}, storage,
        times_ns=[EPOCH_NS + 10**8 * i for i in order],
    )  # fmt: skip
    series = read_frames(path)
    assert [int(image[0, 0, 0]) for image in series.images()] == [20 * i for i in range(10)]
    assert [frame.time_ns for frame in series] == [EPOCH_NS + 10**8 * i for i in range(10)]
    assert any("out of order, sorted by stamp" in note for note in series.notes)


def test_bag_whose_topic_has_two_frame_ids_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x.bag", {TOPIC: NUMBERED[:4]}, sensors=("tip_left", "tip_right"))
    with pytest.raises(InputError, match="images of two sensors, 'tip_left' and 'tip_right'"):
        read_frames(path)


@pytest.mark.parametrize("suffix", [".mkv", ".webm", ".mp4", ".mov", ".avi"])
def test_video_has_exact_times_or_those_of_its_container(tmp_path: Path, suffix: str) -> None:
    series = read_frames(write_video(tmp_path / f"x{suffix}", NUMBERED))
    assert [frame.time.text for frame in series] == [f"{i / 25:.6f}" for i in range(24)]
    assert series.notes == ()
    assert [f.time.text for f in read_frames(tmp_path / f"x{suffix}", fps=50.0)][-1] == "0.460000"
    if suffix != ".avi":  # its rate is constant
        series = read_frames(write_video(tmp_path / f"uneven{suffix}", NUMBERED, UNEVEN_MS))
        assert [round(frame.time_ns / 1e6) for frame in series] == UNEVEN_MS
        (note,) = series.notes
        assert "times: of the video's container" in note


ASSUMED = (
    "times: 25 frames per second assumed, as the file is a raw stream without times: give --fps if they "
    "were taken at another rate",
)


def test_missing_presentation_times_are_interpolated_and_continued() -> None:
    shown = [0, 100, 300, 0, 500, 600, 0, 0]
    times, notes = container_times("x", [10**6 * ms for ms in shown], 25.0)
    assert [float(time.text) for time in times] == [0.0, 0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    assert [time.time_ns for time in times[6:]] == [700_000_000, 800_000_000]
    assert notes[1] == "times: 3 frames without a time, interpolated"
    assert container_times("x", [0, 0, 0], 25.0)[0][-1].text == "0.080000"


@pytest.mark.parametrize("begin", [b"", b"--frame\r\nContent-Type: image/jpeg\r\n\r\n"])
def test_assumed_rate_of_a_raw_stream_is_noted(tmp_path: Path, begin: bytes) -> None:
    parts = [begin + cv2.imencode(".jpg", image)[1].tobytes() + b"\r\n" * bool(begin) for image in NUMBERED]
    path = tmp_path / "x.mjpeg"
    path.write_bytes(b"".join(parts))
    assert read_frames(path).notes == ASSUMED
    assert read_frames(path, fps=50.0).notes == ()


H264 = bytes.fromhex(
    "000000016764000aac7204447b0110000003001000000303c0f12258460000000168e8438f2c8b0000016588810005ff"
    "fef6aefcdc54a970eacbda58dcbdc3bd6941f0c700000001419a086d884ffffdf50c00000001419e102710af14b10000"
    "0001019e184d484fff1810"
)
"""Four grey frames of 64 x 48 px, Annex B, encoded with x264 at 30 frames per second."""
H265 = bytes.fromhex(
    "0000000140010c01ffff01600000030090000003000003001e9598090000000142010101600000030090000003000003"
    "001ea02083165959ae4caf016808000003000800000300f040000000014401c173d0890000012801af0860f124cdeec7"
    "0c132480000000010201d0195f84318410fa9274000000010201e04497e184908c3c80000000010001e024fffa2c2980"
    "8a7e80"
)
"""The same, encoded with x265."""
START = b"\0\0\0\1"
BEGINNINGS = {
    "parameters": (H264, H265),
    "short start code": (H264[1:], H265[1:]),
    "more zeros": (b"\0\0" + H264, b"\0\0" + H265),
    "delimiter": (START + b"\x09\x10" + H264, START + b"\x46\x01\x10" + H265),
    "metadata": (
        START + b"\x06\x05\x10" + bytes(range(1, 17)) + b"\x80" + H264,
        START + b"\x4e\x01\x05\x10" + bytes(range(1, 17)) + b"\x80" + H265,
    ),
}


@pytest.mark.parametrize("begin", BEGINNINGS)
@pytest.mark.parametrize(
    ("suffix", "codec"), [(".h264", 0), (".264", 0), (".mp4", 0), (".h265", 1), (".hevc", 1)]
)
def test_raw_h264_and_h265_have_an_assumed_rate_with_a_note_or_the_given_one(
    tmp_path: Path, begin: str, suffix: str, codec: int
) -> None:
    path = tmp_path / f"x{suffix}"
    path.write_bytes(BEGINNINGS[begin][codec])
    if not cv2.VideoCapture(str(path)).read()[0]:
        pytest.skip(f"this OpenCV does not decode {('H.264', 'H.265')[codec]}")
    assumed = read_frames(path)
    assert [round(frame.time_ns / 1e6) for frame in assumed] == [0, 40, 80, 120]
    assert all(image.shape == (48, 64, 3) and abs(image.mean() - 128.0) < 5.0 for image in assumed.images())
    assert assumed.notes == ASSUMED
    given = read_frames(path, fps=50.0)
    assert [round(frame.time_ns / 1e6) for frame in given] == [0, 20, 40, 60]
    assert given.notes == ()


def test_recorded_camera_plays_a_video_of_variable_rate_at_its_times(tmp_path: Path) -> None:
    times_ms = [0, 10, 60, 70, 120, 130]
    path = write_video(tmp_path / "x.mkv", NUMBERED[:6], times_ms)
    stream = VideoStream(path, 250.0, SystemClock())  # ten times its nominal rate
    stamps = [stream.read().stamped_ns or 0 for _ in times_ms]
    assert [round((stamp - stamps[0]) / 1e6, 1) for stamp in stamps] == [ms / 10 for ms in times_ms]
    stream.close()


@pytest.fixture
def turning(press: Callable[..., Image]) -> tuple[list[Image], list[float]]:
    angles = [0.0] * 16 + np.linspace(0.0, 15.0, 20).tolist() + [15.0] * 6
    return [press(20.0 + angle, seed=i, half_axes=(80.0, 25.0)) for i, angle in enumerate(angles)], angles


@pytest.mark.heavy
@pytest.mark.parametrize(("name", "error_deg"), [("slip", 0.5), ("pca", 2.0), ("ecc", None)])
@pytest.mark.parametrize("step_s", [1.0, 16.667])
def test_frames_far_apart_are_answered_with_a_warning_unless_neighbours_are_compared(
    turning: tuple[list[Image], list[float]],
    blank: Image,
    name: str,
    error_deg: float | None,
    step_s: float,
    caplog: pytest.LogCaptureFixture,
) -> None:
    images, angles = turning
    times_s = step_s * np.arange(len(images))
    found = rig.estimate(images, blank, times_s=times_s, estimator=name, window=1)
    assert "s apart" in caplog.text
    if error_deg is None:
        assert set(found.states[1:]) <= {"lost", "unobservable"}
        assert np.isnan(found.angle_deg[1:]).all()
    else:
        np.testing.assert_allclose(found.angle_deg[12:], angles[12:], atol=error_deg)


@pytest.mark.heavy
def test_repeated_time_is_never_tracking(
    turning: tuple[list[Image], list[float]], blank: Image, caplog: pytest.LogCaptureFixture
) -> None:
    images, _ = turning
    times = np.arange(len(images)) / 60
    times[21] = times[20]
    found = rig.estimate(images, blank, times_s=times)
    assert found.states[21] == "lost"
    assert math.isnan(found.angle_deg[21])
    assert found.angle_deg[-1] == pytest.approx(15.0, abs=1.5)
    assert "frame 21" in caplog.text


@pytest.mark.parametrize("name", ["slip", "pca", "ecc"])
def test_estimator_loses_frames_with_constant_times(
    turning: tuple[list[Image], list[float]], blank: Image, name: str
) -> None:
    estimator = choose_estimator(name).make(blank)
    samples = [estimator.update(image, EPOCH_NS) for image in turning[0]]
    assert {sample.state for sample in samples[1:]} == {State.LOST}
    assert all(sample.angle_deg is None for sample in samples[1:])
