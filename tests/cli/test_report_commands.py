"""`rig report`, `rig compare` and `rig play` as a user types them, on a session."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.report.write import SIZE_PX
from support.angle_clips import write_clip
from support.browser import NEEDS_CHROMIUM
from support.command_line import answer, refusal_line, succeed

Draw = Callable[..., NDArray[np.uint8]]


@pytest.fixture(scope="module")
def trial(one_lift: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one lift that was asked for no report."""
    return Path(shutil.copytree(one_lift, tmp_path_factory.mktemp("cli") / "trial"))


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_trial_without_report_gets_one_by_rig_report(trial: Path) -> None:
    assert not (trial / "report.html").exists()
    done = succeed("report", str(trial))
    assert done.stdout.strip() == str(trial / "report.html")
    assert "toothbrush, lift 1" in (trial / "report.html").read_text()


@NEEDS_CHROMIUM
def test_report_picture_is_taken_by_the_browser(trial: Path, tmp_path: Path) -> None:
    picture = tmp_path / "report.png"
    succeed("report", str(trial), "--out", str(tmp_path / "page.html"), "--picture", str(picture))
    seen = cv2.imread(str(picture))
    assert seen is not None
    assert seen.shape[:2] == SIZE_PX[::-1]
    assert seen.std() > 20
    assert "choose another --picture" in refusal_line(
        "report", str(trial), "--picture", str(tmp_path / "a.jpg")
    )


def test_report_picture_without_a_browser_is_rejected_before_the_page(
    trial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    page = tmp_path / "page.html"
    assert "install chromium" in refusal_line("report", str(trial), "--out", str(page), "--picture", "a.png")
    assert not page.exists()


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_unwritable_report_does_not_fail_the_trial(trial: Path, light_bench_file: Path) -> None:
    same = ("--lifts", 1, "--object", "t2", "--bench", light_bench_file, "--out", trial, "--resume")
    (trial / "report.html").unlink(missing_ok=True)
    (trial / "report.html").mkdir()
    try:
        done = succeed("trial", *same, "--json")
        assert json.loads(done.stdout)["report"] is None
        assert "note: no report" in done.stderr
        assert "Traceback" not in done.stderr
    finally:
        (trial / "report.html").rmdir()


def test_unreadable_session_gets_a_page_and_a_note(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "session.json").write_text('{"schema_version": 99}')
    done = succeed("report", str(folder), "--json")
    written = json.loads(done.stdout)
    assert "schema version 99" in written["problems"][0]
    assert "schema version 99" in Path(written["report"]).read_text()
    assert done.stderr.startswith("note: ")


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_two_estimators_are_compared_on_one_session(
    trial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = {path.name for path in trial.iterdir()}
    monkeypatch.chdir(tmp_path)
    done = succeed("compare", "slip", "pca", "--on", str(trial), "--jobs", "1", "--json")
    written = json.loads(done.stdout)
    assert "1/2 slip: t2 toothbrush" in done.stderr
    assert "2/2 pca: t2 toothbrush" in done.stderr
    assert written["names"] == ["slip", "pca"]
    assert written["lifts"] == 1
    stored = json.loads((trial / "lifts.jsonl").read_text())["re"]["mean_deg"]
    assert written["figures"][0]["first"] == pytest.approx(stored)
    assert written["figures"][0]["second"] != pytest.approx(stored)
    (spent,) = (each for each in written["figures"] if each["figure"].startswith("time per tactile frame"))
    assert min(spent["first"], spent["second"]) > 0.0
    assert "slip and pca compared" in (tmp_path / "compare_slip_pca.html").read_text()
    assert {path.name for path in trial.iterdir()} == inside


def test_impossible_comparisons_missing_lifts_and_missing_sessions_are_rejected(
    trial: Path, tmp_path: Path
) -> None:
    for command, word in (
        (("compare", "slip", "pca"), "needs --on SESSION"),
        (("compare", trial, trial), "given twice"),
        (("compare", trial, tmp_path / "none"), "no session folder"),
        (("compare", "slip", "magic", "--on", trial), "unknown estimator 'magic'"),
        (("play", trial, "--lift", "9", "--out", tmp_path / "lift.webm"), "no finished lift '9'"),
        (("report", tmp_path / "nothing"), "there is no such session"),
        (("report", trial.with_name(f"{trial.name}s")), f"did you mean '{trial.name}'?"),
    ):
        assert word in refusal_line(*command)


@pytest.mark.heavy
def test_first_lift_is_played_into_a_default_file(
    trial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = answer("play", trial, "--speed", "8")
    assert done["film"] == "trial_001.webm"
    assert done["frames"] > 15
    assert (tmp_path / "trial_001.webm").stat().st_size > 10_000
    assert [path.name for path in tmp_path.iterdir()] == ["trial_001.webm"]


@pytest.mark.heavy
def test_mp4_without_an_encoder_becomes_webm_with_a_note(
    trial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.report.film.has_h264", lambda: False)
    done = succeed("play", trial, "--speed", "16", "--out", tmp_path / "lift.mp4")
    assert "no H.264 encoder for .mp4" in done.stderr
    assert done.stdout.strip() == str(tmp_path / "lift.webm")
    assert [path.name for path in tmp_path.iterdir()] == ["lift.webm"]
    assert "is there already" in refusal_line("play", trial, "--speed", "8", "--out", tmp_path / "lift.mp4")


@pytest.mark.heavy
def test_own_frames_are_played(tmp_path: Path, press: Draw, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = write_clip(tmp_path / "pen", press, press(None))
    monkeypatch.chdir(tmp_path)
    same = ("--background", clip / "background.png", "--rate", 10)
    film = answer("play", clip / "frames", *same)
    assert film["film"] == "frames_film.webm"
    assert film["frames"] == pytest.approx(13 / 10 * 30, abs=2)
    video = cv2.VideoCapture("frames_film.webm")
    first, last = video.read()[1].astype(int), None
    while (read := video.read())[0]:
        last = read[1]
    assert last is not None
    assert abs(first[:300, :200] - last[:300, :200]).mean() > 2.0
    same_file = ("play", "frames_film.webm", "--out", "frames_film.webm", "--background", "auto")
    assert "is the source of the film" in refusal_line(*same_file)
    assert "leave --lift and --beside out" in refusal_line("play", clip / "frames", *same, "--lift", 1)
