"""Films of lifts: everything in the picture, as long as the lift, playable."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.errors import InputError, SessionError
from rig.report.film import CURVE_PX, HEIGHT_PX, LEGEND_PX, Film, Filmed, has_h264, write_film
from rig.report.session import find_lift
from rig.sessions.manifest import TrialManifest, read_manifest_of
from support.browser import NEEDS_CHROMIUM, Browser
from support.marks import heavy


@pytest.fixture(scope="module")
def trial(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_trial(tmp_path_factory.mktemp("film") / "session", (12.0,))


def first_lift(session: Path) -> Filmed:
    manifest = read_manifest_of(session, TrialManifest, "no trial")
    return session, manifest, find_lift(session, manifest, "1")


def film(session: Path, out: Path) -> Film:
    return write_film([first_lift(session)], out, fps=10.0)


@pytest.mark.heavy
@pytest.mark.parametrize("ending", [".webm", *heavy(".mp4", ".avi")])
def test_film_has_the_length_of_the_lift_and_its_curve_grows(
    trial: Path, tmp_path: Path, ending: str
) -> None:
    made = film(trial, tmp_path / f"lift{ending}")
    assert made.path.suffix == (".webm" if ending == ".mp4" and not has_h264() else ending)
    assert made.frames == pytest.approx(36, abs=2)  # 1 s of A, 2.5 s of B and C
    video = cv2.VideoCapture(str(made.path))
    pictures = []
    while (read := video.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == made.frames
    height, width = pictures[0].shape[:2]
    assert (width, height) == made.size_px
    below = slice(HEIGHT_PX + 30, HEIGHT_PX + CURVE_PX - 60)
    curve = [picture[below, -500:-40].astype(int) for picture in (pictures[5], pictures[-1])]
    # blue in BGR pictures: the estimate's line is there at the end only
    blue = [int(np.sum((c[..., 0] > c[..., 2] + 60) & (c[..., 0] > 100))) for c in curve]
    assert blue[1] > blue[0] + 200
    first_tips = pictures[0][:HEIGHT_PX, : width // 4].astype(int)
    assert np.abs(first_tips - pictures[-1][:HEIGHT_PX, : width // 4]).mean() > 2.0


@pytest.mark.heavy
def test_animated_image_has_the_requested_length_and_width(trial: Path, tmp_path: Path) -> None:
    out = tmp_path / "lift.webp"
    made = write_film([first_lift(trial)], out, fps=3.0, width_px=320)
    read, animation = cv2.imreadanimation(str(out))
    assert read
    assert len(animation.frames) == made.frames == pytest.approx(11, abs=1)
    assert animation.frames[0].shape[:2] == made.size_px[::-1]
    assert made.size_px[0] == 320
    assert np.abs(animation.frames[5].astype(int) - animation.frames[-1]).mean() > 1.0
    with pytest.raises(InputError, match=r"ends in \.webm"):
        write_film([first_lift(trial)], out, fps=500.0)
    assert [path.name for path in tmp_path.iterdir()] == ["lift.webp"]


@NEEDS_CHROMIUM
@pytest.mark.heavy
def test_a_film_plays_in_a_browser(trial: Path, tmp_path: Path) -> None:
    made = film(trial, tmp_path / "lift.webm")
    (tmp_path / "film.html").write_text("<video src='lift.webm' muted></video>")
    browser = Browser(tmp_path / "profile")
    try:
        browser.open((tmp_path / "film.html").as_uri(), 1280)
        played = """(async () => { const v = document.querySelector('video');
          await v.play(); await new Promise(r => v.ontimeupdate = () => v.currentTime > 0.1 && r());
          return JSON.stringify([v.videoWidth, v.videoHeight, v.error, v.readyState >= 2]); })()"""
        answer = browser.call("Runtime.evaluate", expression=played, awaitPromise=True)
        assert answer["result"]["value"] == f"[{made.size_px[0]},{made.size_px[1]},null,true]"
    finally:
        browser.close()


def test_lifts_are_found_by_number_object_and_name(trial: Path) -> None:
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    numbers = {find_lift(trial, manifest, name).number for name in ("1", "t1/1", "wrench/1")}
    assert numbers == {1}
    with pytest.raises(InputError, match=r"there are 1 \(t1/1 wrench\)"):
        find_lift(trial, manifest, "7")


def test_impossible_films_are_rejected(trial: Path, drawn_trial: Any, tmp_path: Path) -> None:
    broken = drawn_trial(tmp_path / "s", (12.0,))
    (broken / "lifts" / "001.mcap").write_bytes(b"no recording")
    for session, name, error, said in (
        (trial, "lift.gif", InputError, r"\.webm or \.mp4 or \.avi"),
        (trial, "no/lift.mp4", InputError, "no such folder"),
        (broken, "lift.mp4", SessionError, r"001\.mcap"),
    ):
        with pytest.raises(error, match=said):
            film(session, tmp_path / name)


@pytest.mark.heavy
def test_missing_camera_leaves_an_empty_panel_and_two_lifts_are_stacked(
    trial: Path, drawn_trial: Any, tmp_path: Path
) -> None:
    folder = drawn_trial(tmp_path / "s", (12.0,), serials=("T1", "T2", "ANOTHER"))
    assert film(folder, tmp_path / "lift.avi").frames > 10
    filmed = first_lift(trial)
    one = write_film([filmed], tmp_path / "one.webm", fps=2.0)
    both = write_film([filmed, filmed], tmp_path / "both.webm", fps=2.0)
    assert both.frames == one.frames
    assert both.size_px[0] == one.size_px[0]
    assert both.size_px[1] == pytest.approx(2 * one.size_px[1] - 2 * LEGEND_PX, abs=2)
