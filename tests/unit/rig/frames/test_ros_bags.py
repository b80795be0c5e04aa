"""Frames from ROS bags: every storage, every encoding, and errors for damaged bags."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.frames.ros_bags import ENCODINGS, bag_images
from rig.frames.series import read_frames
from support.fuzz import answered, changed, fuzzed
from support.ros_bags import CLOCK_S, TOPIC, write_bag

Image = NDArray[np.uint8]
COLOURS = (np.random.default_rng(3).integers(0, 256, (4, 3, 3)) // 8 * 8).astype(np.uint8)
FRAMES = [np.kron(np.roll(COLOURS, n, 0), np.ones((8, 8, 1), np.uint8)) for n in range(3)]
TIMES_NS = [10, 1_000_000_020, 2_000_000_030]
STORAGES = ("mcap", "sqlite3", "ros1")


def bag(folder: Path, storage: str) -> Path:
    return folder / ("bag.bag" if storage == "ros1" else "bag")


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("encoding", ["rgb8", "png"])
def test_bag_gives_its_frames_with_the_stamps_of_their_headers(
    tmp_path: Path, storage: str, encoding: str
) -> None:
    path = write_bag(bag(tmp_path, storage), {TOPIC: FRAMES}, storage, encoding, TIMES_NS)
    series = read_frames(path)
    assert [frame.time.time_ns for frame in series] == TIMES_NS
    assert [frame.time.text for frame in series] == ["0.000000010", "1.000000020", "2.000000030"]
    assert all(np.array_equal(read, given) for read, given in zip(series.images(), FRAMES, strict=True))
    assert series.notes == (f"{path}: {TOPIC}",)


def test_messages_without_stamps_have_the_time_at_which_the_bag_received_them(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {TOPIC: FRAMES})
    assert [frame.time.text for frame in read_frames(path)] == [f"{CLOCK_S + n}.000000000" for n in range(3)]


def encoded(encoding: str, image: Image) -> Image:
    """Write an image in an encoding, with OpenCV if it supports it."""
    conversions = {
        "bgr8": cv2.COLOR_RGB2BGR, "8UC3": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGB2RGBA,
        "bgra8": cv2.COLOR_RGB2BGRA, "mono8": cv2.COLOR_RGB2GRAY, "8UC1": cv2.COLOR_RGB2GRAY,
        "uyvy": cv2.COLOR_RGB2YUV_UYVY, "yuv422": cv2.COLOR_RGB2YUV_UYVY,
        "yuyv": cv2.COLOR_RGB2YUV_YUY2, "yuv422_yuy2": cv2.COLOR_RGB2YUV_YUY2,
    }  # fmt: skip
    if encoding.startswith("bayer_"):
        mosaic = np.zeros(image.shape[:2], np.uint8)
        for place, channel in enumerate(encoding.removeprefix("bayer_")[:4]):
            rows, columns = slice(place // 2, None, 2), slice(place % 2, None, 2)
            mosaic[rows, columns] = image[rows, columns, "rgb".index(channel)]
        return mosaic
    return image if encoding == "rgb8" else np.asarray(cv2.cvtColor(image, conversions[encoding]), np.uint8)


@pytest.mark.parametrize("encoding", [e.replace("8uc", "8UC") for e in ENCODINGS])
def test_every_encoding_gives_the_colours_that_were_written(tmp_path: Path, encoding: str) -> None:
    written = [encoded(encoding, frame) for frame in FRAMES]
    (image, *_) = read_frames(write_bag(tmp_path / "bag", {TOPIC: written}, encoding=encoding)).images()
    wanted = FRAMES[0]
    if encoding in ("mono8", "8UC1"):
        wanted = np.repeat(written[0][..., None], 3, 2)
    inside = np.zeros(image.shape[:2], bool)
    inside[4::8, 4::8] = True  # the colour of a Bayer pixel is mixed with that of its neighbours
    assert np.abs(image[inside].astype(int) - wanted[inside]).max() <= 8
    assert image.shape == wanted.shape


@pytest.mark.parametrize("pattern", ["bayer_rggb8", "bayer_gbrg8"])
def test_compressed_mosaic_has_the_colours_of_its_pattern(tmp_path: Path, pattern: str) -> None:
    mosaics = [encoded(pattern, frame) for frame in FRAMES]
    packed = write_bag(tmp_path / "png", {TOPIC: mosaics}, encoding=f"{pattern}; png compressed ")
    raw = write_bag(tmp_path / "raw", {TOPIC: mosaics}, encoding=pattern)
    for image, wanted in zip(read_frames(packed).images(), read_frames(raw).images(), strict=True):
        assert np.array_equal(image, wanted)
    colour = write_bag(tmp_path / "colour", {TOPIC: FRAMES}, encoding=f"{pattern}; png compressed bgr8")
    assert all(map(np.array_equal, read_frames(colour).images(), FRAMES))


def test_lines_with_padding_are_read_without_it(tmp_path: Path) -> None:
    padded = np.zeros((32, 40, 3), np.uint8)
    padded[:, :24] = FRAMES[0]
    path = write_bag(tmp_path / "bag", {TOPIC: [padded]})
    (file,) = path.glob("*.mcap")
    head = np.array([32, 40], "<u4").tobytes()
    assert file.read_bytes().count(head) == 1
    file.write_bytes(file.read_bytes().replace(head, np.array([32, 24], "<u4").tobytes()))
    assert np.array_equal(next(read_frames(path).images()), FRAMES[0])


def test_topic_is_needed_if_there_are_several(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {"/right/image": FRAMES[:1], "/left/image": FRAMES[1:]})
    with pytest.raises(InputError, match=r"2 topics .* choose one with --topic: /left/image, /right/image"):
        read_frames(path)
    with pytest.raises(InputError, match=r"unknown topic of images '/left' .* choose one of /left/image"):
        read_frames(path, topic="/left")
    assert len(list(read_frames(path, topic="/left/image"))) == 2


def test_options_that_do_not_fit_are_rejected(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {TOPIC: FRAMES})
    with pytest.raises(InputError, match="contains its times: leave --timestamps and --fps out"):
        read_frames(path, fps=30.0)
    with pytest.raises(InputError, match="is not a ROS bag: leave --topic out"):
        read_frames(tmp_path, topic=TOPIC)


def test_incomplete_images_are_gaps_unless_none_is_complete(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {TOPIC: [FRAMES[0], FRAMES[1][:20]]})
    (file,) = path.glob("*.mcap")
    heights = {rows: np.array([rows, 24], "<u4").tobytes() for rows in (20, 32, 40)}
    file.write_bytes(file.read_bytes().replace(heights[20], heights[40]))
    assert [frame.image is None for frame in read_frames(path)] == [False, True]
    file.write_bytes(file.read_bytes().replace(heights[32], heights[40]))
    with pytest.raises(InputError, match=r"not one complete image in 2 messages \('rgb8'\): record it again"):
        list(read_frames(path))


def test_bags_without_a_readable_image_are_rejected_with_the_cure(tmp_path: Path) -> None:
    for name, frames, encoding, said in (
        ("empty", {TOPIC: []}, "rgb8", "not one complete image in 0 messages"),
        ("nothing", {}, "rgb8", "no topic of images, no topic at all: record sensor_msgs/Image"),
        ("unknown", {TOPIC: FRAMES}, "32FC3",
         r"unknown encoding of images '32FC3'.* choose one of rgb8, .*as JPEG"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            list(read_frames(write_bag(tmp_path / name, frames, encoding=encoding)))


def test_missing_rosbags_is_named_with_the_command_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / "bag", {TOPIC: FRAMES})
    monkeypatch.setattr("rig.config.extras.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r'pip install "visuotactile-slip-rig\[ros2\]"'):
        read_frames(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a bag of each storage, by the ending of its file."""
    folder = tmp_path_factory.mktemp("whole")
    small = [frame[:8, :8] for frame in FRAMES]
    paths = [write_bag(bag(folder, "ros1"), {TOPIC: small}, "ros1")]
    for storage in ("mcap", "sqlite3"):
        paths += write_bag(folder / storage, {TOPIC: small}, storage).glob("*.[!y]*")
    return {path.suffix: path.read_bytes() for path in paths}


@pytest.mark.parametrize("ending", [".mcap", ".db3", ".bag"])
def test_bags_cut_short_are_rejected_with_the_cure(
    whole: dict[str, bytes], tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"cut{ending}"
    path.write_bytes(whole[ending][:-100])
    with pytest.raises(InputError, match=r"cannot be read as a ROS bag .* ros2 bag reindex"):
        list(read_frames(path))


@pytest.mark.heavy
@fuzzed()
@given(data=st.data())
@pytest.mark.parametrize("ending", [".mcap", ".db3", ".bag"])
def test_damaged_bags_answer_or_raise_a_typed_error(
    whole: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory, ending: str, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged{ending}"
    path.write_bytes(data.draw(changed([whole[ending]])))
    answered(lambda: list(bag_images(path, TOPIC)))
    answered(lambda: list(read_frames(path)))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_file_inside_a_bag_is_read_and_noted_if_the_bag_is_split(tmp_path: Path, storage: str) -> None:
    path = write_bag(tmp_path / "bag", {TOPIC: FRAMES}, storage)
    (file,) = [each for each in path.iterdir() if each.suffix != ".yaml"]
    assert len(list(read_frames(file))) == 3
    (path / "other_1.mcap").write_bytes(b"")
    first = file.rename(file.with_name(f"bag_0{file.suffix}"))
    assert len(read_frames(first).notes) == 2, "only the note on times"
    for number in (1, 2, 10, 11):
        (path / f"bag_{number}{file.suffix}").write_bytes(b"")
    assert read_frames(first).notes[-1] == (
        f"{first}: is one file of a bag with 4 more files (bag_1{file.suffix}, "
        f"bag_2{file.suffix}, bag_10{file.suffix}): give the folder to read all"
    )
