"""Recording grasp poses: stored and rejected frames, and continuing after a kill."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.types import Frame
from rig.experiments.record import FRAMES_APART, PoseCapture
from rig.sessions.rows import read_poses
from rig.tactile.contact.finder import ContactFinder
from support.command_line import rig


@pytest.mark.heavy
def test_frames_without_contact_are_rejected_and_counted() -> None:
    rng = np.random.default_rng(0)
    empty = np.full((320, 240, 3), 100, np.uint8)
    pressed = empty.copy()
    cv2.ellipse(pressed, (120, 160), (30, 70), 20, 0, 360, (180, 60, 120), -1)
    observer = PoseCapture({"L": ContactFinder(empty), "R": ContactFinder(empty)})
    observer.want(4, grip_steps=2)
    for number in range(8 * FRAMES_APART):
        for serial in ("L", "R"):
            picture = pressed if number >= 2 * FRAMES_APART else empty
            noisy = (picture + rng.normal(0, 1.5, picture.shape)).clip(0, 255).astype(np.uint8)
            observer.frame(Frame(noisy, number, number, serial))
    assert observer.is_complete()
    assert observer.rejected == 4
    assert sorted(frame.serial for frame, _, _ in observer.taken) == ["L", "L", "R", "R"]
    assert all(area > 0 and grip == 2 for _, grip, area in observer.taken)


@pytest.mark.heavy
def test_killed_recordings_are_completed_without_repeating_poses(
    light_bench_file: Path, tmp_path: Path
) -> None:
    chance = random.Random(5)
    what = ["--object", "mug", "--poses", "3", "--images", "12", "--bench", str(light_bench_file)]
    command = ["record", *what, "--no-report", "--out"]
    out = [str(tmp_path / "s"), "--resume"]
    done: list[int] = []
    for _ in range(3):
        words = [sys.executable, "-m", "rig", *command, *out]
        process = subprocess.Popen(words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        time.sleep(chance.uniform(1.0, 3.0))
        process.send_signal(signal.SIGKILL)
        process.wait()
        rows = read_poses(tmp_path / "s")
        assert [row.pose for row in rows][: len(done)] == done
        done = [row.pose for row in rows]
    figures = json.loads(rig(*command, *out, "--json").stdout)
    assert (figures["poses_accepted"], figures["images_accepted"]) == (3, 12)
    whole = rig(*command, tmp_path / "t", "--json")
    assert json.loads(whole.stdout)["images_accepted"] == 12
    for path in sorted((tmp_path / "t").rglob("*.png")):
        assert path.read_bytes() == (tmp_path / "s" / path.relative_to(tmp_path / "t")).read_bytes()
    kept = (tmp_path / "s" / "poses.jsonl").read_text()
    assert kept == (tmp_path / "t" / "poses.jsonl").read_text()
    assert (tmp_path / "s" / "images.csv").read_text() == (tmp_path / "t" / "images.csv").read_text()
