"""`rig live` without a page: text, a JSON object per frame, files to their end, and errors with the cure."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
import pytest

from drivers.images import encode_png
from drivers.types import Frame, Image
from rig.cli.live import DeskOptions, LiveOptions, _stored, desk_of
from rig.live.clip_writer import ClipWriter
from rig.live.feed import OBJECT
from rig.live.state import WITH_CONTACT
from rig.report.session import find_lift
from rig.sessions.manifest import TrialManifest, read_manifest_of
from support.command_line import rig
from support.desk_frames import desk_frames
from support.marks import heavy
from support.ros_bags import TOPIC, write_bag
from support.waiting import LIMIT_S, until


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of a fingertip: half a second without contact, then the touch and the turn."""
    folder = tmp_path_factory.mktemp("desk") / "frames"
    folder.mkdir()
    for frame in desk_frames(7.5, from_s=2.0):
        (folder / f"{frame.sequence}.jpg").write_bytes(frame.jpeg or b"")
    return folder


@pytest.mark.heavy
def test_json_has_an_object_per_frame_until_the_file_ends(clip: Path) -> None:
    done = rig("live", clip, "--fps", "30", "--json")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) + lines[-1]["dropped"] == len(list(clip.iterdir()))
    assert {"t_s", "angle_deg", "sigma_deg", "state", "rate_deg_s", "latency_ms"} <= set(lines[0])
    assert (lines[0]["sensor"], lines[0]["state"], lines[0]["angle_deg"]) == (
        "frames", "taking the background", None,
    )  # fmt: skip
    assert {line["state"] for line in lines} >= {"no_contact", "tracking"}
    assert "all 165 images have been played" in done.stderr


def test_each_of_two_clips_has_its_own_background(tmp_path: Path) -> None:
    clips = [tmp_path / "left", tmp_path / "right"]
    for number, folder in enumerate(clips):
        image = np.full((64, 48, 3), 50 + number, np.uint8)
        with closing(ClipWriter(folder, image, {})) as clip:
            clip.add(Frame(image, 0, 0, "D"))
    with ExitStack() as stack:
        desk = desk_of(DeskOptions([str(folder) for folder in clips]), stack)
    given = [sensor.background.image for sensor in desk.sensors.values()]
    assert [int(image.max()) for image in given if image is not None] == [50, 51]


@pytest.mark.heavy
def test_file_waits_for_the_estimator_and_its_summary_counts_every_frame(clip: Path) -> None:
    """The frames come faster than they can be estimated."""
    done = rig("live", clip, "--fps", "1000", "--terminal")
    assert done.returncode == 0, done.stderr
    found = re.search(
        r"; (\d+) of 165 frames with an angle; without: (.*); 0 dropped", done.stderr.replace("\n", " ")
    )
    assert found, done.stderr
    refused = sum(int(part.split()[0]) for part in found[2].split(", "))
    assert int(found[1]) + refused == 165
    assert int(found[1]) > 100


@pytest.mark.heavy
def test_json_ends_when_its_reader_has_gone() -> None:
    command = [sys.executable, "-m", "rig", "live", "fake", "--json", "--seconds", "100"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.stdout.close()
        assert process.wait(timeout=120) == 0


@pytest.mark.heavy
def test_terminal_shows_a_line_now_and_then(clip: Path) -> None:
    done = rig("live", clip, "--fps", "30", "--terminal", "--seconds", "4")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("frames: angle     -    , taking the background; - frames/s, 0 dropped")
    assert 2 <= len(lines) <= 6


@pytest.mark.heavy
def test_two_fakes_are_fused() -> None:
    done = rig("live", "fake", "fake", "--json", "--seconds", "3")
    assert done.returncode == 0, done.stderr
    sensors = {json.loads(line)["sensor"] for line in done.stdout.splitlines()}
    assert sensors == {"SIM-DESK1", "SIM-DESK2", "object"}
    assert "SIMULATED rig live fake fake" in done.stderr


@pytest.mark.heavy
@pytest.mark.parametrize("waits", ["SIM-DESK1", *heavy("taking the background")])
def test_ctrl_c_ends_it_wherever_it_is(waits: str) -> None:
    command = [sys.executable, "-P", "-u", "-m", "rig", "live", "fake", "fake", "--terminal"]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, **both) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(waits):
                break
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(30) == 0, rest
        assert rest.endswith("ended\n")


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("moment", "times"),
    [
        ("numpy", 2),
        *heavy(("typer", 1), ("rig.live.desk", 1), ("rig.cli.main", 1), ("multiprocessing.reduction", 1)),
    ],
)
def test_ctrl_c_while_it_starts_ends_it_without_a_traceback(moment: str, times: int) -> None:
    """The signal comes once this module is imported, in the command or in its page's process."""
    imports = [sys.executable, "-P", "-u", "-X", "importtime", "-m", "rig", "live", "fake", "--no-browser"]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "start_new_session": True}
    with subprocess.Popen(imports, **both) as process:
        assert process.stdout is not None
        found = next(line for line in process.stdout if line.rpartition("|")[2].strip() == moment)
        assert found
        for _ in range(times):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(60) in (0, 3), rest
        assert "Traceback" not in rest
        assert "Fatal" not in rest


@pytest.mark.parametrize(
    ("arguments", "code", "match"),
    [
        (["nowhere.avi"], 2, "there is no such file or folder"),
        (["/dev/video77"], 1, "there is no such device"),
        (["http://127.0.0.1:9/x"], 1, "the connection was refused"),
        (["fake", "fake", "fake"], 2, "3 sources: give one, or two"),
        (["fake", "fake", "--gel", "gel.yaml"], 2, "--gel is for one sensor"),
        (["fake", "--sensor", "eye"], 2, "--sensor eye: choose one of digit, gelsight-mini, plain"),
        (["fake", "--watch-at", "127.0.0.1:0"], 2, "--watch-at is the address of the page"),
        (["fake", "--estimator", "toskov"], 2, "needs the wrench at the arm's wrist"),
    ],
)
def test_wrong_source_or_option_is_one_line(arguments: list[str], code: int, match: str) -> None:
    for view in (["--terminal"], [] if arguments[-1] == "nowhere.avi" else ["--json"]):
        done = rig("live", *arguments, *view)
        assert done.returncode == code
        assert match in done.stderr
        assert "http://127.0.0.1:" not in done.stderr.replace("http://127.0.0.1:9/x", ""), "no page is opened"


def press(address: str, action: str) -> None:
    """Press a button of the page."""
    with urlopen(Request(f"{address}do", action.encode())) as answer:
        assert answer.status == 200


@contextmanager
def viewing(clips: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Run `rig live fake`; yield its process and its page's address once the background is taken."""
    command = [sys.executable, "-P", "-u", "-m", "rig", "live", "fake", "--no-browser", "--clips", clips]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        address = next(found[0] for line in lines if (found := re.search(r"http://\S+/(?=;)", line)))
        assert any("background taken" in line for line in lines)
        yield process, address


@pytest.mark.heavy
@pytest.mark.parametrize("signals", [(signal.SIGKILL,), *heavy(((signal.SIGINT, signal.SIGTERM),))])
def test_clip_of_a_live_view_that_is_killed_is_complete(
    tmp_path: Path, signals: tuple[signal.Signals, ...]
) -> None:
    with viewing(tmp_path) as (process, address):
        press(address, "record")
        until(lambda: len(list(tmp_path.glob("*/frames/[0-9]*.jpg"))) > 20)
        for number in signals:
            process.send_signal(number)
        process.wait(LIMIT_S)
    (clip,) = tmp_path.iterdir()
    frames = {file.name for file in (clip / "frames").glob("[0-9]*.jpg")}
    header, *rows = (clip / "timestamps.csv").read_text().splitlines()
    assert header == "frame,t_s"
    assert frames <= {row.split(",")[0] for row in rows}
    done = rig("estimate", clip, "--out", tmp_path / "angles.csv")
    assert done.returncode == 0, done.stderr
    times_s = [float(row.split(",")[0]) for row in (tmp_path / "angles.csv").read_text().splitlines()[1:]]
    assert len(times_s) == len(frames)
    assert times_s[-1] > times_s[0] == 0.0


@pytest.mark.heavy
def test_clip_that_is_being_saved_at_the_end_is_complete_and_named(tmp_path: Path) -> None:
    with viewing(tmp_path) as (process, address):
        assert process.stderr is not None
        press(address, "save")
        assert any("saving the last 30 s" in line for line in iter(process.stderr.readline, ""))
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        assert process.wait(LIMIT_S) == 0, said
    (clip,) = tmp_path.iterdir()
    count = len(list((clip / "frames").iterdir()))
    assert f"{clip}: {count} frames" in said.replace("\n", "")


def test_background_may_be_given_or_is_that_of_the_clip(clip: Path, tmp_path: Path) -> None:
    empty: Image = next(iter(desk_frames(2.1))).image
    (tmp_path / "empty.png").write_bytes(encode_png(empty))
    (tmp_path / "pen_2").mkdir()
    (tmp_path / "pen_2" / "frames").symlink_to(clip)
    (tmp_path / "pen_2" / "background.png").write_bytes(encode_png(empty))
    for words in ((clip, "--background", tmp_path / "empty.png"), (tmp_path / "pen_2",)):
        done = rig("live", *words, "--fps", "30", "--json", "--seconds", "1")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout.splitlines()[0])["state"] == "no_contact"


@pytest.mark.heavy
def test_bridge_publishes_until_the_file_ends(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loopback = "<Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces>"
    uri = f"<CycloneDDS><Domain><General>{loopback}</General></Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    done = rig("bridge", "ros2", clip, "--fps", "15", "--domain", "99")
    assert done.returncode == 0, done.stderr
    assert "publishing in domain 99: /frames/image_raw/compressed, /angle/frames, /slip/frames" in done.stderr
    messages = int(done.stderr.split("ended: ")[1].split()[0])
    assert 150 < messages <= 3 * len(list(clip.iterdir()))


@pytest.mark.heavy
@pytest.mark.parametrize("lift", ["1", None])
def test_lift_of_a_session_is_opened_with_both_fingertips_and_the_object(
    one_lift: Path, lift: str | None
) -> None:
    manifest = read_manifest_of(one_lift, TrialManifest, "")
    recording = one_lift / find_lift(one_lift, manifest, None).recording
    source = one_lift if lift else recording
    history, name, faults = _stored(LiveOptions([str(source)], lift=lift, page=True))
    assert (name, faults) == (f"SIMULATED {recording}", [])
    assert set(history.sensors) == {*manifest.signs, OBJECT}
    for serial in manifest.signs:
        sensor = history.sensors[serial]
        contact = [point[6] in WITH_CONTACT for point in sensor.points]
        images = 5 * (sensor.points[-1][0] - sensor.points[0][0]) + sum(a != b for a, b in pairwise(contact))
        assert len(sensor.pictures) == pytest.approx(images, abs=2)
    assert {event["text"] for event in history.events} >= {"contact", "zero"}
    angles = {
        name: [point[1] for point in sensor.points if point[1] is not None]
        for name, sensor in history.sensors.items()
    }
    last_deg = [angles[serial][-1] for serial in manifest.signs]
    assert len(angles[OBJECT]) > 60
    assert min(last_deg) - 2.0 < angles[OBJECT][-1] < max(last_deg) + 2.0
    assert np.ptp(angles[OBJECT]) > 5.0


@pytest.mark.heavy
def test_bag_is_opened_as_a_whole(tmp_path: Path) -> None:
    frames = list(desk_frames(5.0))
    bag = write_bag(
        tmp_path / "bag", {TOPIC: [f.image for f in frames]}, times_ns=[f.time_ns for f in frames]
    )
    history, _, _ = _stored(LiveOptions([str(bag)], page=True, estimator="ellipse", topic=TOPIC))
    (sensor,) = history.sensors.values()
    assert len(sensor.points) == len(frames)
    assert history.began_s == pytest.approx(2.0)


@pytest.mark.heavy
def test_only_the_last_ten_minutes_of_a_long_clip_are_kept(clip: Path) -> None:
    history, _, _ = _stored(LiveOptions([str(clip)], page=True, estimator="ellipse", fps=0.25))
    (sensor,) = history.sensors.values()
    assert history.began_s == 0.0
    assert sensor.points[0][0] == pytest.approx(164 / 0.25 - 600.0, abs=4.0)


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["CLIP", "--page", "--terminal"], "leave --terminal, --json and --sensor out"),
        (["CLIP", "CLIP", "--page"], "--page shows one stored clip"),
        (["CLIP", "--page", "--lift", "2"], "is not a session: leave --lift out"),
        (["CLIP", "--lift", "2"], "add --page"),
        (["nowhere", "--page"], "there is no such file or folder"),
        (["CLIP", "--page", "--watch-at", "8080"], "write host and port"),
    ],
)
def test_options_that_do_not_fit_a_stored_clip_are_refused(
    clip: Path, arguments: list[str], cause: str
) -> None:
    done = rig("live", *(str(clip) if each == "CLIP" else each for each in arguments), "--no-browser")
    assert done.returncode == 2
    assert cause in " ".join(done.stderr.split())
