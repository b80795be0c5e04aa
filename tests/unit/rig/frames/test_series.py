"""Reading anyone's frames: folders, images, videos, backgrounds."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.images import read_image, with_jpeg
from drivers.types import Frame
from rig.frames.series import make_background, read_frames
from rig.sessions.recorder import LiftRecorder
from support.videos import write_video

Image = NDArray[np.uint8]
Draw = Callable[..., Image]


def write(path: Path, image: Image) -> Path:
    assert cv2.imwrite(str(path), np.ascontiguousarray(image[..., ::-1]))
    return path


def grey(level: int, size: tuple[int, int] = (24, 32)) -> Image:
    return np.full((size[1], size[0], 3), level, np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for i in (2, 10, 1):
        write(tmp_path / f"frame{i}.png", grey(i))
    return tmp_path


def test_images_come_in_the_order_people_count_at_an_assumed_rate_with_a_note(folder: Path) -> None:
    (folder / "notes.txt").write_text("no image")
    (folder / ".frame0.png").write_bytes(b"hidden")
    series = read_frames(folder)
    assert [(f.name, f.time.text, int(f.image[0, 0, 0])) for f in series if f.image is not None] == [
        ("frame1.png", "0.000000", 1), ("frame2.png", "0.016667", 2), ("frame10.png", "0.033333", 10)
    ]  # fmt: skip
    assert "60 frames per second assumed" in series.notes[0]
    assert read_frames(folder, fps=60.0).notes == ()


def test_background_beside_the_images_is_no_frame(folder: Path) -> None:
    write(folder / "background.png", grey(200))
    series = read_frames(folder)
    assert [f.name for f in series] == ["frame1.png", "frame2.png", "frame10.png"]
    assert series.notes[-1] == "background.png: the background, not a frame"
    background, note = make_background(None, series)
    assert (int(background[0, 0, 0]), note) == (200, "background: the set's own")


def test_two_images_of_one_name_are_rejected(folder: Path) -> None:
    write(folder / "frame2.jpg", grey(2))
    with pytest.raises(InputError, match=r"frame2\.jpg and frame2\.png: keep one image of"):
        read_frames(folder)


def test_folder_of_a_video_and_a_background_is_a_clip(tmp_path: Path) -> None:
    write_video(tmp_path / "clip.avi", [grey(level) for level in (10, 20, 30)])
    write(tmp_path / "background.png", grey(200))
    series = read_frames(tmp_path)
    assert [f.time.text for f in series] == ["0.000000", "0.040000", "0.080000"]
    assert int(make_background(None, series)[0][0, 0, 0]) == 200
    (tmp_path / "clip.avi").unlink()
    with pytest.raises(InputError, match="neither a folder 'frames' nor a video"):
        read_frames(tmp_path)


def test_frames_are_rgb(tmp_path: Path) -> None:
    red = np.zeros((32, 24, 3), np.uint8)
    red[..., 0] = 200
    assert np.array_equal(read_image(write(tmp_path / "red.png", red)), red)
    series = read_frames(tmp_path / "red.png")
    assert [frame.time.time_ns for frame in series] == [0]
    image = next(read_frames(write_video(tmp_path / "red.avi", [red] * 3)).images())
    assert abs(int(image[5, 5, 0]) - 200) < 12
    assert image[5, 5, 2] < 12


def test_video_rate_is_used_unless_fps_is_given(tmp_path: Path) -> None:
    path = write_video(tmp_path / "clip.avi", [grey(20 * i) for i in range(5)])
    assert [f.time.text for f in read_frames(path)][-1] == "0.160000"
    assert [f.time.text for f in read_frames(path, fps=50.0)][-1] == "0.080000"
    assert [f.name for f in read_frames(path)] == ["0", "1", "2", "3", "4"]


def test_truncated_video_is_read_to_its_end_with_a_note(tmp_path: Path, press: Draw) -> None:
    whole = write_video(tmp_path / "whole.avi", [press(9 * i, seed=i) for i in range(10)]).read_bytes()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole[: len(whole) // 2])
    series = read_frames(cut)
    count = sum(1 for _ in series)
    assert 0 < count < 10
    assert f"10 frames announced, {count} can be read" in series.notes[0]


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_an_image_cut_short_is_a_gap_and_alone_an_error(tmp_path: Path, press: Draw, ending: str) -> None:
    for i in range(3):
        write(tmp_path / f"{i}.{ending}", press(10 * i))
    damaged = tmp_path / f"1.{ending}"
    damaged.write_bytes(damaged.read_bytes()[:-3000])
    assert [frame.image is None for frame in read_frames(tmp_path)] == [False, True, False]
    with pytest.raises(InputError, match=f"1.{ending}"):
        read_frames(damaged)
    with pytest.raises(InputError, match=f"1.{ending}: is not a complete picture"):
        read_image(damaged)


@pytest.mark.parametrize("content", [b"", b"no image at all", b"\xff\xd8\xff\xd9", b"\x89PNG IEND"])
def test_folder_without_one_good_image_is_rejected(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InputError, match="not one complete image"):
        read_frames(tmp_path)


def test_missing_files_mixed_sizes_and_impossible_rates_are_rejected(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("neither image nor video")
    for name, said in (
        ("empty", "no images in it"), ("missing", "no such file"), ("text.txt", r"text\.txt: neither"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_frames(tmp_path / name)
    for fps in (0.0, -5.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="not a frame rate"):
            read_frames(folder, fps=fps)
    write(folder / "frame11.png", grey(3, (32, 24)))
    with pytest.raises(InputError, match=r"'frame11.png' is 32 x 24 px, the first 24 x 32"):
        list(read_frames(folder))


def test_the_background_is_an_image_or_made_from_frames(tmp_path: Path, folder: Path) -> None:
    series = read_frames(folder)
    given, _ = make_background(str(write(tmp_path / "bare.bmp", grey(7))), read_frames(folder / "frame1.png"))
    assert np.array_equal(given, grey(7))
    first, note = make_background("first:2", series)
    assert np.array_equal(first, grey(2))
    assert "first 2" in note
    made, note = make_background("auto", read_frames(folder))
    assert made.shape == (32, 24, 3)
    assert "auto" in note


def test_frames_that_are_all_alike_make_no_background_without_choice(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match="give --background"):
        make_background(None, read_frames(folder))
    for i in range(12):
        write(tmp_path / f"more{i}.png", grey(9))
    with pytest.raises(InputError, match="neither the first frames nor the most frequent ones"):
        make_background(None, read_frames(tmp_path))


def test_invalid_background_is_rejected(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "aside").mkdir()
    other = write(tmp_path / "aside" / "other.bmp", grey(7, (32, 32)))
    counts = ("first:0", "first:", "first:-3", "first:x", "first:2.5", "first:99")
    for spec, said in (
        *((spec, f"--background {spec}") for spec in counts),
        (str(other), r"other.bmp: the background is 32 x 32 px, the frames are 24 x 32"),
        (str(tmp_path / "nowhere.png"), r"nowhere\.png"),
    ):
        with pytest.raises(InputError, match=said):
            make_background(spec, read_frames(folder))


@pytest.mark.parametrize("ending", [".npy", ".npz"])
def test_array_of_frames_is_read_as_rgb(tmp_path: Path, ending: str) -> None:
    frames = np.stack([grey(20 * i) for i in range(4)])
    frames[..., 0] = 200
    path = tmp_path / f"clip{ending}"
    np.save(path, frames) if ending == ".npy" else np.savez_compressed(path, frames)
    series = read_frames(path, fps=10.0)
    assert np.array_equal(np.stack(list(series.images())), frames)
    assert [frame.time.text for frame in series][-1] == "0.300000"
    assert series.notes == (f"{path}: 4 frames of 24 x 32 px, assumed to be RGB",)
    assert "60 frames per second assumed" in read_frames(path).notes[1]


@pytest.mark.parametrize(
    ("array", "why"),
    [
        (np.zeros((4, 32, 24, 3), np.float32), "it is float32 of shape"),
        (np.zeros((4, 32, 24), np.uint8), "uint8 of shape (4, 32, 24)"),
        (np.zeros((4, 3, 32, 24), np.uint8), "uint8 of shape (4, 3, 32, 24)"),
        (np.asfortranarray(np.zeros((4, 32, 24, 3), np.uint8)), "not stored one after another"),
        (np.array([{}], object), "it is object"),
    ],
)
def test_other_arrays_are_rejected_with_the_cure(tmp_path: Path, array: NDArray[Any], why: str) -> None:
    np.save(tmp_path / "clip.npy", array)
    with pytest.raises(InputError, match=r"save one array \(T, H, W, 3\) of uint8, RGB") as error:
        read_frames(tmp_path / "clip.npy")
    assert why in str(error.value)


def test_archive_of_two_arrays_and_array_cut_short_are_rejected(tmp_path: Path) -> None:
    frames = np.zeros((4, 32, 24, 3), np.uint8)
    np.savez(tmp_path / "two.npz", left=frames, right=frames)
    np.save(tmp_path / "cut.npy", frames)
    (tmp_path / "cut.npy").write_bytes((tmp_path / "cut.npy").read_bytes()[:-100])
    for name, said in (("two.npz", "it holds 2 arrays, not one"), ("cut.npy", "it is cut short")):
        with pytest.raises(InputError, match=said):
            read_frames(tmp_path / name)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of three cameras, as OpenCV takes it for a video of JPEG pictures."""
    path = tmp_path / "001.mcap"
    with path.open("wb") as stream:
        recorder = LiftRecorder(stream)
        recorder.phase("reference", 0)
        for number in range(9):
            for serial in ("T1", "T2", "CAM"):
                recorder.frame(with_jpeg(Frame(grey(20 * number), number, number, serial)))
        recorder.close()
    return path


@pytest.mark.parametrize("ending", [".avi", ".bag", ".bin", ""])
def test_recording_is_never_read_as_a_video_though_opencv_finds_pictures(
    recording: Path, ending: str
) -> None:
    other = recording.with_name(f"other{ending}")
    is_recording = ending == ".avi"
    other.write_bytes(recording.read_bytes() if is_recording else b"bag" + recording.read_bytes()[3:])
    assert cv2.VideoCapture(str(other)).grab(), "OpenCV takes it for a video"
    said = (
        "recording of several sensors.*rig estimate" if is_recording else "neither images nor a video .* give"
    )
    with pytest.raises(InputError, match=said):
        read_frames(other)


def test_devices_streams_stacks_and_folders_of_clips_are_rejected_with_a_cure(
    tmp_path: Path, recording: Path
) -> None:
    for endless in ("/dev/null", "http://127.0.0.1:8080/stream", "rtsp://sensor/1"):
        with pytest.raises(InputError, match="has no end: record a clip of it"):
            read_frames(Path(endless))
    with pytest.raises(InputError, match=r"give one of its files, as .*001\.mcap"):
        read_frames(recording.parent)
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), [grey(1), grey(2)])
    with pytest.raises(InputError, match="holds 2 images, but only one would be read"):
        read_frames(tmp_path / "stack.tif")


def test_images_of_a_recording_session_are_no_clip(folder: Path) -> None:
    images = folder / "t1_wrench" / "image_label"
    images.mkdir(parents=True)
    write(images / "p01_01_T1.png", grey(1))
    assert len(list(read_frames(images))) == 1
    (folder / "poses.jsonl").write_text("")
    with pytest.raises(InputError, match="of several sensors and poses from a recording session, not a clip"):
        read_frames(images)


def test_copies_are_left_out_and_other_equal_images_named(folder: Path) -> None:
    for name in ("frame2 - Copy", "frame2 (1)", "frame3"):
        shutil.copy(folder / "frame2.png", folder / f"{name}.png")
    write(folder / "frame1 (2).png", grey(77))  # a number of another program, no copy
    series = read_frames(folder, fps=10.0)
    names = ["frame1.png", "frame1 (2).png", "frame2.png", "frame3.png", "frame10.png"]
    assert [frame.name for frame in series] == names
    assert series.notes == (
        "2 copied images left out, as 'frame2 (1).png'",
        "1 image equal to the image before, byte for byte, as 'frame3.png'",
    )


@pytest.mark.parametrize(
    ("names", "unit", "since_s"),
    [
        (["a_1.005", "a_1.1", "a_1.16"], "s", [0.0, 0.095, 0.155]),
        (["1763000000.95", "1763000001.0", "1763000001.052"], "s", [0.0, 0.05, 0.102]),
        ([f"{1763000000950 + 40 * i}" for i in range(3)], "ms", [0.0, 0.04, 0.08]),
        ([f"{1763000000950000001 + 40_000_000 * i}" for i in range(3)], "ns", [0.0, 0.04, 0.08]),
        (["1.001", "1.002", "1.003"], None, [0.0, 1 / 60, 1 / 30]),  # frames of lift 1
        (["1.08", "1.09", "1.10"], None, [0.0, 1 / 60, 1 / 30]),
    ],
)
def test_names_that_are_times_are_used_with_a_note(
    tmp_path: Path, names: list[str], unit: str | None, since_s: list[float]
) -> None:
    for level, name in enumerate(names):
        write(tmp_path / f"{name}.png", grey(level))
    series = read_frames(tmp_path)
    times = [frame.time_ns for frame in series]
    assert [(time - times[0]) / 1e9 for time in times] == pytest.approx(since_s, abs=1e-6)
    (note,) = series.notes
    assert f"those in the names, in {unit}, " in note if unit else "60 frames per second assumed" in note
    assert read_frames(tmp_path, fps=60.0).notes == ()


def test_frames_of_two_sensors_are_refused_with_both_names(tmp_path: Path) -> None:
    sides = [with_texture(seed) for seed in (1, 2)]
    frames = [sides[i % 2] + np.uint8(i // 4) for i in range(9)]
    with pytest.raises(InputError, match="frames '0' and '1' are of two sensors"):
        list(read_frames(write_video(tmp_path / "both.avi", frames)))
    for i in range(2):
        for side in ("left", "Right"):
            write(tmp_path / f"{side}_{i}.png", grey(i))
    with pytest.raises(InputError, match=r"'left_1.png' and 'Right_1.png' are of two sensors"):
        read_frames(tmp_path)


def with_texture(seed: int) -> Image:
    coarse = np.random.default_rng(seed).integers(60, 160, (8, 6, 3), np.uint8)
    return np.asarray(cv2.resize(coarse, (48, 64), interpolation=cv2.INTER_CUBIC), np.uint8)
