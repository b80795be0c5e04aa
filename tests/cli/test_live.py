"""`rig live` and `rig bridge`: text, a JSON object per frame, signals, and errors with the cure."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import numpy as np
import pytest

from drivers.types import Frame
from rig.cli.live import DeskOptions, desk_of
from rig.live.clip_writer import ClipWriter
from rig.live.feed import NO_FRAMES
from rig.live.sensor_background import BACKGROUND_FRAMES
from support.command_line import rig, succeed
from support.desk_frames import desk_frames
from support.marks import heavy


@pytest.mark.heavy
def test_json_has_an_object_per_frame_and_the_summary_counts_them() -> None:
    done = succeed("live", "fake", "--estimator", "ellipse", "--json", "--seconds", "6")
    lines = [line for line in map(json.loads, done.stdout.splitlines()) if line["state"] != NO_FRAMES]
    assert {"t_s", "angle_deg", "sigma_deg", "state", "rate_deg_s", "latency_ms"} <= set(lines[0])
    assert (lines[0]["sensor"], lines[0]["state"], lines[0]["angle_deg"]) == (
        "SIM-DESK1", "taking the background", None,
    )  # fmt: skip
    assert {line["state"] for line in lines} >= {"no_contact", "tracking"}
    assert "SIMULATED rig live fake" in done.stderr
    answered = sum(line["angle_deg"] is not None for line in lines)
    assert f"{answered} of {len(lines)} frames with an angle" in done.stderr


def test_background_is_given_or_that_of_each_clip(tmp_path: Path) -> None:
    clips = [tmp_path / "left", tmp_path / "right"]
    for number, folder in enumerate(clips):
        image = np.full((64, 48, 3), 50 + number, np.uint8)
        with closing(ClipWriter(folder, image, {})) as clip:
            clip.add(Frame(image, 0, 0, "D"))
    given = clips[1] / "background.png"
    for sources, background, greys in (
        (clips, None, [50, 51]),
        (["fake", "fake"], given, [51, 51]),
        (["fake"], None, []),
    ):
        with ExitStack() as stack:
            desk = desk_of(DeskOptions([*map(str, sources)], background=background), stack)
        images = [sensor.background.image for sensor in desk.sensors.values()]
        assert [int(image.max()) for image in images if image is not None] == greys


@pytest.mark.heavy
def test_json_ends_when_its_reader_has_gone() -> None:
    command = [sys.executable, "-m", "rig", "live", "fake", "--json", "--seconds", "100"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.stdout.close()
        assert process.wait(timeout=120) == 0


@pytest.mark.heavy
def test_terminal_shows_a_line_now_and_then() -> None:
    done = succeed("live", "fake", "--terminal", "--seconds", "3.5")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("SIM-DESK1: angle     -    , taking the background; - frames/s, 0 dropped")
    assert 2 <= len(lines) <= 5


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
        (
            ["fake", "CLIP"],
            2,
            "CLIP is stored, and rig live is for sensors: rig show CLIP shows it on the page",
        ),
        (["/dev/video77"], 1, "there is no such device"),
        (["http://127.0.0.1:9/x"], 1, "the connection was refused"),
        (["fake", "fake", "fake"], 2, "3 sources: give one, or two"),
        (["fake", "fake", "--gel", "gel.yaml"], 2, "--gel is for one sensor"),
        (["fake", "--sensor", "eye"], 2, "--sensor eye: choose one of digit, gelsight-mini, plain"),
        (["fake", "--watch-at", "127.0.0.1:0"], 2, "--watch-at is the address of the page"),
        (["fake", "--estimator", "toskov"], 2, "needs the wrench at the arm's wrist"),
    ],
)
def test_wrong_source_or_option_is_one_line(
    arguments: list[str], code: int, match: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "CLIP").mkdir()
    monkeypatch.chdir(tmp_path)
    for view in (["--terminal"], [] if arguments[-1] == "nowhere.avi" else ["--json"]):
        done = rig("live", *arguments, *view)
        assert done.returncode == code
        assert match in done.stderr
        assert "http://127.0.0.1:" not in done.stderr.replace("http://127.0.0.1:9/x", ""), "no page is opened"


@pytest.mark.heavy
def test_bridge_publishes_every_frame_of_a_clip_although_they_come_faster_than_they_are_estimated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, frames = tmp_path / "frames", list(desk_frames(7.5, from_s=2.0))
    folder.mkdir()
    for frame in frames:
        (folder / f"{frame.sequence}.jpg").write_bytes(frame.jpeg or b"")
    loopback = "<Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces>"
    uri = f"<CycloneDDS><Domain><General>{loopback}</General></Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    done = succeed("bridge", "ros2", folder, "--fps", "1000", "--domain", "99")
    assert "publishing in domain 99: /frames/image_raw/compressed, /angle/frames, /slip/frames" in done.stderr
    assert re.search(r"; (\d+) of 165 frames with an angle; .*; 0 dropped", done.stderr.replace("\n", " "))
    # each frame has an image, and after those of the background also an angle and whether it slips
    assert f"ended: {165 + 2 * (165 - BACKGROUND_FRAMES)} messages" in done.stderr
