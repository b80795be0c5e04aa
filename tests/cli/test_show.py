"""`rig show`: a stored clip or lift as a whole on the page, and errors with the cure."""

import json
import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

from rig.cli.show import ShowOptions, estimate_stored
from rig.live.feed import OBJECT
from rig.live.state import WITH_CONTACT
from rig.sessions.manifest import TrialManifest, read_manifest_of
from support.command_line import refusal
from support.desk_frames import desk_frames, write_desk_clip
from support.waiting import LIMIT_S

STORED = Path(__file__).resolve().parents[1] / "data" / "stored_trial"


def test_page_shows_the_clip_until_ctrl_c(tmp_path: Path) -> None:
    write_desk_clip(clip := tmp_path / "pen", 4.5, every=2)
    command = [sys.executable, "-P", "-u", "-m", "rig", "show", clip, "--no-browser"]
    with subprocess.Popen([*command, "--estimator", "ellipse"], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        line = next(line for line in lines if "press Ctrl-C" in line)
        found = re.fullmatch(r"SIMULATED (\S+) at (http://\S+/); press Ctrl-C to end\n", line)
        assert found is not None, line
        assert found[1] == str(clip)
        with urlopen(f"{found[2]}state.json") as answer:
            state = json.load(answer)
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(LIMIT_S) == 0, rest
    assert rest.endswith("ended\n")
    assert state["began_s"] == 0.0
    assert {"contact", "zero", "mark 1"} <= {event["text"] for event in state["events"]}


@pytest.mark.heavy
def test_lift_of_a_session_is_opened_with_both_fingertips_and_the_object(one_lift: Path) -> None:
    manifest = read_manifest_of(one_lift, TrialManifest, "")
    title, history, faults = estimate_stored(ShowOptions(one_lift, lift="1"))
    assert (title, faults) == (f"SIMULATED {one_lift / 'lifts' / '001.mcap'}", [])
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


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["clip", "--lift", "2"], "is not a session: leave --lift out"),
        (["clip", "--watch-at", "8080"], "write host and port"),
        (["clip", "--topic", "/image"], "is not a ROS bag"),
        (["nowhere"], "there is no such file or folder"),
        ([STORED, "--lift", "9"], "no finished lift '9'"),
        ([STORED, "--fps", "30"], "contains times and sensors: leave --gel, --fps and --topic out"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    arguments: list[str], cause: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "clip").mkdir()
    (tmp_path / "clip" / "0.jpg").write_bytes(next(desk_frames(2.1)).jpeg or b"")
    monkeypatch.chdir(tmp_path)
    assert cause in " ".join(refusal("show", *arguments, "--no-browser").split())
