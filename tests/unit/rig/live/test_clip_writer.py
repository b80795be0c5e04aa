"""A clip is usable at any moment of its recording, and an interrupted one is read with notes."""

import json
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RecordingError
from drivers.images import encode_jpeg, with_jpeg
from drivers.types import Frame, Image
from rig.frames.clips import ABOUT, FRAMES, TIMES
from rig.frames.series import read_frames
from rig.live.clip_writer import MARKS, Clips, ClipWriter, clip_folder
from rig.live.desk import Desk, DeskSettings
from rig.live.feed import Sender
from rig.live.sensor_background import SensorBackground
from rig.tactile.estimators import choose_estimator
from support.desk_frames import GivenFrames, desk_frames
from support.marks import heavy
from support.waiting import until

GREY: Image = np.full((8, 6, 3), 128, np.uint8)
JPEG = encode_jpeg(GREY, 80)
STEP_NS = 20_000_000


def frame(number: int) -> Frame:
    return Frame(GREY, 5_000_000_000 + STEP_NS * number, number, "D1", JPEG)


def recorded(folder: Path, count: int) -> Path:
    """Record a clip of frames at 50 Hz."""
    clip = ClipWriter(folder, GREY, {"sensor": "D1", "simulated": False})
    add(clip, count)
    clip.close()
    return folder


def add(clip: ClipWriter, count: int) -> None:
    for _ in range(count):
        clip.add(frame(len(clip.times_ns)))


def read(clip: Path) -> tuple[list[float], list[str]]:
    """Return the times of all frames in s, and the notes, except that all images are equal."""
    series = read_frames(clip)
    frames = list(series)
    assert all(each.image is not None for each in frames)
    notes = [note for note in series.notes if "byte for byte" not in note]
    return [each.time.time_ns / 1e9 for each in frames], notes


def lines(clip: Path) -> list[str]:
    return (clip / TIMES).read_text().splitlines(keepends=True)


@contextmanager
def limited(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_each_frame_has_its_time_while_the_clip_is_recorded(tmp_path: Path) -> None:
    clip = ClipWriter(tmp_path / "c", GREY, {})
    for number in range(5):
        clip.add(frame(number))
        assert read(tmp_path / "c") == (pytest.approx([0.02 * n for n in range(number + 1)]), [])
    clip.close()


@pytest.mark.parametrize("size", [len(JPEG) - 1, len(JPEG) + 10, len(JPEG) + 25])
def test_full_disk_leaves_a_clip_that_can_be_read(tmp_path: Path, size: int) -> None:
    clip = ClipWriter(tmp_path / "c", GREY, {})
    clip.add(frame(0))
    said = rf"{tmp_path}/c.*: the clip cannot be written \("
    with limited(size), pytest.raises(RecordingError, match=said):
        add(clip, 100)
    clip.close()
    times, notes = read(tmp_path / "c")
    assert times == pytest.approx([0.02 * n for n in range(len(clip.times_ns))])
    assert len(list((tmp_path / "c" / FRAMES).iterdir())) == len(clip.times_ns), "no incomplete frame is left"
    assert all(line.endswith("\n") for line in lines(tmp_path / "c"))
    assert len(notes) == len(lines(tmp_path / "c")) - 1 - len(clip.times_ns)


RECORD = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from unit.rig.live.test_clip_writer import ClipWriter, GREY, frame
clip = ClipWriter(Path(sys.argv[1]), GREY, {{}})
for number in range(1_000_000):
    clip.add(frame(number))
    print(number, flush=True)
"""


@pytest.mark.heavy
@pytest.mark.parametrize("frames", [30, *heavy(1, 400)])
def test_killed_recording_keeps_every_frame_with_its_time(tmp_path: Path, frames: int) -> None:
    code = RECORD.format(tests=str(Path(__file__).parents[3]))
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "c"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert any(int(line) >= frames for line in process.stdout)
        process.send_signal(signal.SIGKILL)
    times, _ = read(tmp_path / "c")
    assert len(times) > frames
    assert times == pytest.approx([0.02 * n for n in range(len(times))])


EVEN, ASSUMED = 0.02, 1 / 60
"""Steps between the recorded times, and between the times that are assumed without any, s."""
TABLES: dict[str, tuple[Callable[[list[str]], str], float, str]] = {
    **{
        f"only {kept} rows": (
            lambda rows, kept=kept: "".join(rows[: kept + 1]), EVEN, f"{10 - kept} of 10 frames have no time"
        )
        for kept in (2, 3, 7, 9)
    },
    "one row": (lambda rows: "".join(rows[:2]), ASSUMED, ""),
    "a row in between is missing": (lambda rows: "".join(r for r in rows if "000003" not in r), EVEN, ""),
    **{f"cut by {cut}": (lambda rows, cut=cut: "".join(rows)[:-cut], EVEN, "") for cut in (1, 4, 12, 20)},
    **{
        repr(text): (lambda _, text=text: text, ASSUMED, "has no times: 60 frames per second assumed")
        for text in ("", "frame,t_s\n", "frame,t", "frame,t_s\n000000.jpg,0.0")
    },
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_times_that_an_interrupted_table_lacks_are_computed(tmp_path: Path, name: str) -> None:
    change, step_s, note = TABLES[name]
    clip = recorded(tmp_path / "c", 10)
    (clip / TIMES).write_text(change(lines(clip)))
    times, notes = read(clip)
    assert times == pytest.approx([step_s * n for n in range(10)], abs=1e-6)
    assert note in "".join(notes)


def test_row_without_a_frame_is_ignored_and_a_last_row_without_an_end_counts(tmp_path: Path) -> None:
    clip = recorded(tmp_path / "c", 6)
    for number in (0, 3, 5):
        (clip / FRAMES / f"{number:06d}.jpg").unlink()
    times, notes = read(clip)
    assert times == pytest.approx([0.02, 0.04, 0.08])
    assert any("3 rows without a frame, ignored" in note for note in notes)
    by_hand = recorded(tmp_path / "by_hand", 3)
    (by_hand / ABOUT).unlink()
    (by_hand / TIMES).write_text("frame,t_s\n0,0\n1,0.5\n2,0.7")
    assert read(by_hand) == ([0.0, 0.5, 0.7], [])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,angle\n0,1\n", "has no column frame, t_s"),
        ("frame,t_s\n000001.jpg,0.1\n", "'000000.jpg' has no row"),
        ("frame,t_s\n000000.jpg,0.1\n000001.jpg,soon\n", "'soon' is not a number"),
        ("frame,t_s\n000000.jpg,0.1\n000001.jpg,0.0\n", "comes before line 2"),
        ("frame,t_s\nx.jpg,0.1\n", "there is no frame 'x.jpg'"),
    ],
)
def test_invalid_table_of_a_clip_is_rejected(tmp_path: Path, text: str, said: str) -> None:
    clip = recorded(tmp_path / "c", 3)
    (clip / TIMES).write_text(text)
    with pytest.raises(InputError, match=said):
        read_frames(clip)


SHAPE = (64, 48, 3)


def clips_of(folder: Path, *names: str, simulated: bool = False, keeps_frames: bool = True) -> Clips:
    backgrounds = {name: SensorBackground(np.full(SHAPE, 90, np.uint8), None) for name in names}
    return Clips(folder, backgrounds, simulated, keeps_frames)


def noise(count: int, jpeg: bool = False) -> list[Frame]:
    """Return frames of noise at 50 Hz."""
    images = np.random.default_rng(0).integers(0, 255, (count, *SHAPE), np.uint8)
    frames = [Frame(image, 5_000_000_000 + STEP_NS * n, n, "D1") for n, image in enumerate(images)]
    return [with_jpeg(frame) for frame in frames] if jpeg else frames


def saved(clips: Clips) -> str:
    """Save the newest frames; wait for the result."""
    clips.save_last()
    until(lambda: not clips._saving.is_alive())
    return clips.take_saved() or ""


@pytest.mark.parametrize("jpeg", [True, False])
def test_saved_clip_has_the_newest_frames_unchanged_also_during_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jpeg: bool
) -> None:
    monkeypatch.setattr("rig.live.clip_writer.SAVED_S", 0.5)
    clips, frames = clips_of(tmp_path, "D1"), noise(40, jpeg)
    for number, each in enumerate(frames):
        if number == 10:
            clips.begin()
        clips.add("D1", each, 0.0)
    clips.mark(frames[24].time_ns, "mark 1")
    notices = [saved(clips), saved(clips)]
    assert clips.is_recording, "the recording goes on"
    clips.close()
    recorded, *of_saved = sorted(tmp_path.iterdir(), key=lambda one: one.stat().st_ctime_ns)
    assert notices == [f"saved {clip}: 26 frames, 0.5 s" for clip in of_saved]
    assert len(list((recorded / FRAMES).iterdir())) == 30
    for clip in of_saved:
        kept = list(read_frames(clip).read())
        assert [one.time.time_ns for one in kept] == [STEP_NS * n for n in range(26)]
        files = sorted((clip / FRAMES).iterdir())
        assert [file.suffix for file in files] == [".jpg" if jpeg else ".png"] * 26
        for one, file, given in zip(kept, files, frames[-26:], strict=True):
            assert file.read_bytes() == given.jpeg if jpeg else np.array_equal(one.image, given.image)
        assert (clip / MARKS).read_text() == "time_s,text\n0.200000000,mark 1\n"
    assert (recorded / MARKS).read_text() == "time_s,text\n0.280000000,mark 1\n"


def test_frames_that_are_kept_for_saving_are_bounded_in_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.live.clip_writer.MOST_SAVED_BYTES", 10 * int(np.prod(SHAPE)))
    clips = clips_of(tmp_path, "D1")
    for each in (*noise(25), *noise(30)[28:]):
        clips.add("D1", each, 0.0)
    assert len(clips._newest["D1"].frames) == 10
    gap = "10 frames, 0.2 s; 1 gap between the frames, the longest 0.08 s, 0.140 s after the first frame"
    assert gap in saved(clips)


def test_saved_frames_of_a_sensor_that_was_unplugged_are_of_the_last_30_s_too(tmp_path: Path) -> None:
    clips = clips_of(tmp_path, "D1", "D2")
    for name, seconds in (("D1", 20), ("D2", 40)):
        for second in range(seconds):
            clips.add(name, Frame(GREY, second * NS_PER_S, second, name), 0.0)
    saved(clips)
    counts = {folder.name[18:]: len(list((folder / FRAMES).iterdir())) for folder in tmp_path.iterdir()}
    assert counts == {"D1": 11, "D2": 31}


@pytest.mark.parametrize("simulated", [True, False])
def test_clip_says_whether_its_sensor_is_simulated(tmp_path: Path, simulated: bool) -> None:
    clips = clips_of(tmp_path, "D1", simulated=simulated)
    clips.begin()
    clips.close()
    (clip,) = tmp_path.iterdir()
    about = json.loads((clip / ABOUT).read_text())
    assert (about["sensor"], about["simulated"], about["background"]) == ("D1", simulated, "the given image")


def test_clip_that_cannot_be_saved_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    clips = clips_of(tmp_path / "file" / "clips", "D1")
    clips.add("D1", frame(0), 0.0)
    assert "the clip cannot be written (Not a directory)" in saved(clips)


def test_all_sensors_are_recorded_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "D2").touch()
    monkeypatch.setattr("rig.live.clip_writer.clip_folder", lambda clips, serial: clips / serial / "clip")
    clips = clips_of(tmp_path, "D1", "D2")
    with pytest.raises(RecordingError, match=r"the clip cannot be written \(Not a directory\)"):
        clips.begin()
    assert not clips.is_recording


@pytest.mark.parametrize("action", ["record", "save"])
def test_clip_needs_a_background(tmp_path: Path, action: str) -> None:
    clips = Clips(tmp_path, {"D1": SensorBackground(None, None)}, simulated=False, keeps_frames=True)
    with pytest.raises(InputError, match=f"{action}: wait until the background is taken"):
        (clips.begin if action == "record" else clips.save_last)()


def test_full_disk_ends_the_clips_and_the_live_view_goes_on(tmp_path: Path) -> None:
    frames = list(desk_frames(2.6))
    settings = DeskSettings(choose_estimator("ellipse"), backgrounds=(frames[0].image,), clips=tmp_path)
    with Desk([GivenFrames(frames)], settings, Sender()) as desk:
        desk.act("record")
        desk.step()
        with limited(1000):
            assert desk.step()
        assert not desk.clips.is_recording
        assert str(tmp_path) in desk.notice
        assert "the clip cannot be written (File too large); recorded" in desk.notice
        assert desk.step()
    (clip,) = tmp_path.iterdir()
    assert len(read(clip)[0]) == 1


def test_folder_of_a_clip_has_a_valid_name_for_any_sensor(tmp_path: Path) -> None:
    for serial in ("http://10.0.0.2/stream?key=" + "a" * 300, "\N{HIRAGANA LETTER A}" * 300):
        folder = clip_folder(tmp_path, serial)
        folder.mkdir()
        assert clip_folder(tmp_path, serial) != folder
