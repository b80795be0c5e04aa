"""`rig label-angle`: from a clip to labels that the benchmark reads."""

import json
import re
import stat
import threading
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.benchmark.clips.labelled import read_clips
from support.angle_clips import FIRST_CONTACT, TURN_DEG, ask, draw_all, write_clip
from support.command_line import refusal, rig, succeed

Draw = Callable[..., NDArray[np.uint8]]
Browse = Callable[[Callable[[str], None]], None]
REFERENCE = ("--reference", FIRST_CONTACT)


def address_in(way: str) -> str:
    """Return the address to which the file that is opened leads a browser."""
    found = re.search('url=([^"]+)', Path(urlsplit(way).path).read_text())
    assert found is not None
    return found[1]


def labels_two_frames(address: str) -> None:
    draw_all(address, [2, 13])
    ask(address, "write", {})


@pytest.fixture
def clip(tmp_path: Path, press: Draw, blank: NDArray[np.uint8]) -> Path:
    return write_clip(tmp_path / "pen", press, blank)


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Browse:
    """Lets a person work on the page that the command opens, while the command waits."""

    def works(task: Callable[[str], None]) -> None:
        def browse(way: str) -> bool:
            address = address_in(way)
            threading.Thread(target=task, args=(address,), daemon=True).start()
            return True

        monkeypatch.setattr("webbrowser.open", browse)

    return works


@pytest.mark.heavy
def test_lines_become_labels_that_the_benchmark_reads(clip: Path, person: Browse) -> None:
    def task(address: str) -> None:
        draw_all(address, [2, 6, 9, 13], shift_px=0.5)
        ask(address, "write", {})

    person(task)
    done = succeed("label-angle", clip, *REFERENCE, "--count", 4, "--json")
    assert json.loads(done.stdout) == {"out": str(clip / "labels.csv"), "labels": 4, "frames": 4}
    assert "is one of them: rig benchmark clips compares the other 3" in done.stderr
    (found,) = read_clips(clip)
    assert [label.angle_deg for label in found.labels] == pytest.approx(
        [TURN_DEG[n] for n in (4, 7, 11)], abs=0.1
    )
    judged = rig("benchmark", "clips", clip, "--estimator", "pca", "--out", clip.parent / "judged", "--json")
    assert judged.returncode in (0, 4), judged.stderr


@pytest.mark.heavy
def test_key_is_in_a_file_of_this_user_alone(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def browse(way: str) -> bool:
        file = Path(urlsplit(way).path)
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        opened.append(way)
        address = address_in(way)
        key = urlsplit(address).query.removeprefix("key=")
        assert len(key) >= 16
        assert key not in way
        draw_all(address, [2, 13])
        return ask(address, "write", {})[0] == 200

    monkeypatch.setattr("webbrowser.open", browse)
    assert rig("label-angle", clip, *REFERENCE, "--count", 2).returncode == 0
    assert not Path(urlsplit(opened[0]).path).exists()


@pytest.mark.heavy
def test_missing_background_is_the_first_frame_and_other_frames_than_before_are_refused(
    clip: Path, person: Browse
) -> None:
    (clip / "background.png").unlink()
    person(labels_two_frames)
    done = succeed("label-angle", clip, *REFERENCE, "--count", 2)
    assert "rig benchmark clips needs a background.png" in done.stderr
    refused = refusal("label-angle", clip, *REFERENCE, "--count", 5)
    assert "was begun with 2 frames and the reference 2" in refused


@pytest.mark.heavy
def test_existing_labels_are_replaced_only_with_overwrite(clip: Path, person: Browse) -> None:
    (clip / "labels.csv").write_text("reference_frame,keyframe,angle_deg,sigma_deg\n2,6,1,1\n")
    assert "--overwrite" in refusal("label-angle", clip, *REFERENCE)
    person(labels_two_frames)
    assert rig("label-angle", clip, *REFERENCE, "--count", 2, "--overwrite").returncode == 0
    assert "2,13," in (clip / "labels.csv").read_text()


def test_invalid_clip_is_rejected(clip: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    (empty / "frames").mkdir(parents=True)
    for path, why in [
        (tmp_path / "nowhere", "no such folder"),
        (clip / "background.png", "no such folder"),
        (clip / "frames", "is no clip, it has neither a folder 'frames' nor a video"),
        (empty, "no images in it"),
    ]:
        done = rig("label-angle", path, "--no-browser")
        assert done.returncode == 2, path
        assert why in done.stderr
        assert len(done.stderr.splitlines()) == 1
