"""Public data sets: clips made from a clone, its checks, the README's row; a set read as published."""

import csv
import hashlib
import json
import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from drivers.errors import InputError
from drivers.images import encode_png, read_image
from rig.benchmark.clips import public
from rig.benchmark.clips.labelled import read_clips
from rig.benchmark.clips.public import SETS, PublicSet, make_clips
from rig.benchmark.clips.study import ClipsOptions, measure
from rig.benchmark.harness import Run
from rig.cli.main import app
from rig.contract_checks import gel
from rig.frames.clips import trial_turns_deg
from rig.frames.series import make_background, read_frames
from support.command_line import answer
from support.public_sets import about_z, turns_deg, write_trial
from support.videos import write_video

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
LABELS = "clip,reference_frame,keyframe,angle_deg,sigma_deg\n" + "".join(
    f"{clip},3,{frame},{angle},1\n"
    for clip in ("pictures", "movie")
    for frame, angle in ((3, 0), (5, 4), (7, 8), (9, 12))
)
TURN_DEG = (*[0.0] * 4, *np.arange(2.0, 14.0, 2.0))


def git(folder: Path, *arguments: str) -> str:
    author = ["-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", "-C", str(folder), *author, *arguments], capture_output=True, check=True)
    return done.stdout.decode().strip()


@pytest.fixture(scope="module")
def frames(press: Draw) -> list[Image]:
    return [press(15 + turn, (85, 25), seed=i) for i, turn in enumerate(TURN_DEG)]


@pytest.fixture(scope="module")
def clone(frames: list[Image], blank: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository with pictures (one with an alpha channel) and a video; its first commit has the files."""
    folder = tmp_path_factory.mktemp("clone")
    git(folder, "init", "-q")
    for number in range(3):
        noisy = np.clip(blank.astype(int) + number - 1, 0, 255).astype(np.uint8)
        (folder / f"empty {number}.png").write_bytes(encode_png(noisy))
    for number, image in enumerate(frames[1:], 1):
        (folder / f"{number}.png").write_bytes(encode_png(image))
    cv2.imwrite(str(folder / "1.png"), cv2.cvtColor(frames[1], cv2.COLOR_RGB2BGRA))
    write_video(folder / "movie.avi", (blank, *frames))
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "files")
    return folder


@pytest.fixture
def tiny(clone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PublicSet:
    """The labels and sources of the clone, and an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rows = [("pictures", "background", f"empty {number}.png", "", "") for number in range(3)]
    rows += [("pictures", "frame", "", "", "0")]
    rows += [("pictures", "frame", f"{n}.png", "", f"{n / 25}") for n in range(1, len(TURN_DEG))]
    rows += [("movie", "background", "movie.avi", "0", ""), ("movie", "video", "movie.avi", "", "")]
    hashes = {
        path: hashlib.sha256((clone / path).read_bytes()).hexdigest() for _, _, path, *_ in rows if path
    }
    sources = [",".join((*row, hashes.get(row[2], ""))) for row in rows]
    (tmp_path / "tiny.csv").write_text(LABELS)
    (tmp_path / "tiny_sources.csv").write_text("\n".join(["clip,use,path,frame,t_s,sha256", *sources]) + "\n")
    commit = git(clone, "rev-list", "--max-parents=0", "HEAD")
    return PublicSet("tiny", "a drawn sensor", "example/tiny", commit, "MIT", tmp_path)


@pytest.mark.heavy
def test_clips_are_made_in_the_cache_with_the_pixels_of_the_commit(
    tiny: PublicSet, clone: Path, frames: list[Image], blank: Image, tmp_path: Path
) -> None:
    folder = make_clips(tiny, clone)
    assert folder.parent == tmp_path / "cache" / "visuotactile-slip-rig" / "clips"
    movie, pictures = read_clips(folder)
    assert (movie.name, pictures.name) == ("movie", "pictures")
    assert [label.angle_deg for label in pictures.labels] == [4.0, 8.0, 12.0]
    made = list(pictures.series.images())
    assert np.array_equal(pictures.background, blank)  # the median of three
    assert np.array_equal(made[0], blank)
    assert all(np.array_equal(a, b) for a, b in zip(made[1:], frames[1:], strict=True))
    assert [frame.time.text for frame in pictures.series][:3] == ["0", "0.04", "0.08"]
    source = list(read_frames(clone / "movie.avi").images())
    assert all(np.array_equal(a, b) for a, b in zip(movie.series.images(), source, strict=True))
    assert np.array_equal(movie.background, source[0])


@pytest.mark.heavy
def test_only_other_labels_give_another_folder(tiny: PublicSet, clone: Path, tmp_path: Path) -> None:
    folder = make_clips(tiny, clone)
    later = tmp_path / "later"
    git(tmp_path, "clone", "-q", str(clone), str(later))
    (later / "1.png").write_bytes(b"changed")
    git(later, "commit", "-qam", "changes a file")
    git(tmp_path, "clone", "-q", "--bare", str(later), str(tmp_path / "bare.git"))
    for other in (later, tmp_path / "bare.git", later / ".git"):
        assert make_clips(tiny, other) == folder
    tiny.labels.write_text(LABELS.replace(",12,1", ",13,1"))
    changed = make_clips(tiny, clone)
    assert changed != folder
    assert read_clips(changed)[0].labels[-1].angle_deg == 13.0


def test_wrong_folders_and_commits_are_rejected_with_the_command_that_helps(
    tiny: PublicSet, clone: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"no such folder: .*git clone https://github.com/example/tiny"):
        make_clips(tiny, tmp_path / "nowhere")
    (tmp_path / "plain").mkdir()
    with pytest.raises(InputError, match=r"not a git repository.*git clone https://github.com/example/tiny"):
        make_clips(tiny, tmp_path / "plain")
    later, shallow = tmp_path / "later", tmp_path / "shallow"
    git(tmp_path, "clone", "-q", str(clone), str(later))
    git(later, "commit", "-q", "--allow-empty", "-m", "later")
    git(tmp_path, "clone", "-q", "--depth", "1", later.as_uri(), str(shallow))
    with pytest.raises(
        InputError, match=f"has no commit {tiny.commit[:8]} of example/tiny.*fetch --unshallow"
    ):
        make_clips(tiny, shallow)
    git(shallow, "fetch", "-q", "--unshallow")
    assert make_clips(tiny, shallow).is_dir()


def test_changed_file_is_rejected_even_if_clips_are_in_the_cache(
    tiny: PublicSet, clone: Path, tmp_path: Path
) -> None:
    make_clips(tiny, clone)
    other = tmp_path / "other"
    git(tmp_path, "clone", "-q", str(clone), str(other))
    (other / "3.png").write_bytes((other / "4.png").read_bytes())
    git(other, "commit", "-qam", "changes a labelled file")
    with pytest.raises(InputError, match=r"3\.png at .* has the SHA-256 .*, the labelled file had"):
        make_clips(replace(tiny, commit=git(other, "rev-parse", "HEAD")), other)


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("PATH", "", "git was not found"),
        ("GIT_DIR", "{clone}/.git", "not a git repository"),  # the repository of the environment is not used
        ("XDG_CACHE_HOME", "{folder}/file", "set XDG_CACHE_HOME to a writable folder"),
    ],
)
def test_unsuitable_environment_is_named(
    tiny: PublicSet, clone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, value: str,
    message: str,
) -> None:  # fmt: skip
    (tmp_path / "plain").mkdir()
    (tmp_path / "file").touch()
    monkeypatch.setenv(variable, value.format(clone=clone, folder=tmp_path))
    with pytest.raises(InputError, match=message):
        make_clips(tiny, tmp_path / "plain" if variable == "GIT_DIR" else clone)


@pytest.mark.heavy
def test_command_scores_the_set_and_prints_its_row_of_the_readme(
    tiny: PublicSet, clone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SETS, "tiny", tiny)
    command = ["benchmark", "clips", str(clone), "--set", "tiny", "--estimator", "pca"]
    done = CliRunner().invoke(app, command, env={"COLUMNS": "300"})
    assert done.exit_code == 0, done.output
    assert re.search(r"clips of tiny at \w{8}: .*/clips/tiny-\w{8}; licence of the frames: MIT", done.output)
    row = r"\| a drawn sensor \| within 3 degrees: (\d+)% \[\d+, \d+\] of 6 labels on 2 clips \|"
    assert re.search(row, done.output)
    wrong = CliRunner().invoke(app, ["benchmark", "clips", str(clone), "--set", "octopy"])
    assert "unknown set 'octopy' (did you mean 'octopi'?)" in str(wrong.exception)


@pytest.mark.parametrize(
    ("name", "clips", "labels"), [("octopi", 24, 120), ("digit-edges", 5, 38), ("gripper-slips", 2, 17)]
)
def test_packaged_labels_have_sources_with_hashes(name: str, clips: int, labels: int) -> None:
    of = SETS[name]
    rows = list(csv.DictReader(of.labels.read_text().splitlines()))
    assert len({row["clip"] for row in rows}) == clips
    assert sum(row["keyframe"] != row["reference_frame"] for row in rows) == labels
    sources = list(csv.DictReader(of.sources.read_text().splitlines()))
    assert {row["clip"] for row in sources} == {row["clip"] for row in rows}
    assert all(bool(row["path"]) == bool(re.fullmatch("[0-9a-f]{64}", row["sha256"])) for row in sources)
    assert re.fullmatch("[0-9a-f]{40}", of.commit)
    for clip in {row["clip"] for row in rows}:
        uses = [row["use"] for row in sources if row["clip"] == clip]
        assert "background" in uses
        assert ("video" in uses) != ("frame" in uses)


@pytest.mark.parametrize("name", SETS)
def test_packaged_labels_are_the_measured_ones(name: str, real_data: Path) -> None:
    folder = real_data / ("rotation_clips" if name == "octopi" else "real_turns")
    measured = csv.DictReader((folder / "labels.csv").read_text().splitlines())
    by_frame = {(row["clip"], row["keyframe"]): row for row in measured}
    for row in csv.DictReader(SETS[name].labels.read_text().splitlines()):
        found = by_frame[row["clip"], row["keyframe"]]
        assert all(found[key] == row[key] for key in set(row) - {"group"})


@pytest.fixture
def real_clones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Clones of the public repositories, each in OWNER+NAME/repo of the folder RIG_CLONES; an empty cache."""
    folder = Path(os.environ.get("RIG_CLONES", "no clones are given"))
    if not folder.is_dir():
        pytest.skip("no clones of the public sets: put them into a folder, and set RIG_CLONES to it")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return {name: folder / of.repository.replace("/", "+") / "repo" for name, of in SETS.items()}


@pytest.mark.parametrize("name", SETS)
def test_real_clones_give_the_labelled_frames(
    name: str, real_clones: dict[str, Path], real_clips: Path, real_data: Path
) -> None:
    clips = sorted(make_clips(SETS[name], real_clones[name]).iterdir())
    assert clips
    for clip in clips:
        if name != "octopi":
            labelled = real_data / "real_turns" / clip.name
            for file in [*labelled.glob("clip.*"), *labelled.glob("frames/*"), labelled / "background.png"]:
                assert (clip / file.relative_to(labelled)).read_bytes() == file.read_bytes(), file
            continue
        labelled = real_clips / clip.name
        made = list(read_frames(clip / "clip.mov"))
        rebuilt = list(read_frames(labelled / "frames", labelled / "timestamps.csv"))
        assert [frame.time_ns for frame in made] == [frame.time_ns for frame in rebuilt]
        assert all(np.array_equal(a.image, b.image) for a, b in zip(made, rebuilt, strict=True))
        assert np.array_equal(read_image(clip / "background.png"), read_image(labelled / "background.png"))


@pytest.mark.heavy
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SETS)
def test_rows_of_the_readme_are_what_the_command_prints(name: str, real_clones: dict[str, Path]) -> None:
    command = ["benchmark", "clips", str(real_clones[name]), "--set", name]
    done = CliRunner().invoke(app, [*command, "--estimator", "slip", "--json"], env={"COLUMNS": "1000"})
    assert json.loads(done.stdout)["limits"] == []
    (row,) = [line for line in done.output.splitlines() if line.startswith("| a real")]
    assert row in (Path(public.__file__).parents[3] / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tracking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trials of two objects."""
    root = tmp_path_factory.mktemp("TactileTracking")
    for name in ("key0", "bead3"):
        write_trial(root / name)
    return root


@pytest.mark.heavy
def test_a_trial_of_tactile_tracking_is_a_labelled_clip(tracking: Path) -> None:
    clips = read_clips(tracking)
    assert [(clip.name, clip.group) for clip in clips] == [("bead3", "bead"), ("key0", "key")]
    clip = clips[1]
    assert [label.frame for label in clip.labels] == [13, 26, 39]  # half a second apart at 25 a second
    truth = turns_deg()
    assert [label.angle_deg for label in clip.labels] == pytest.approx(
        [truth[i] for i in (13, 26, 39)], abs=0.01
    )
    assert len(read_clips(tracking / "key0")) == 1


@pytest.mark.heavy
def test_background_uses_pixels_without_contact(tracking: Path) -> None:
    series = read_frames(tracking / "key0")
    assert any("contact_masks.npy" in note for note in series.notes)
    background, note = make_background(None, series)
    assert note == "background: the set's own"
    assert np.abs(background.astype(float) - gel(320, 240)).mean() < 3.0


@pytest.mark.heavy
def test_estimators_are_compared_with_the_known_turns(tracking: Path) -> None:
    overall = measure(ClipsOptions(tracking / "key0", ["slip"]), Run()).tables[1].records[0]["score"]
    assert overall.mean_deg < 3.0
    assert float(overall.within) >= 0.8
    done = answer("benchmark", "clips", tracking / "key0", "--estimator", "pca", "--reversed-turns")
    reversed_turns = done["estimators"]["pca"]["all"]
    assert reversed_turns["labels"] == 3
    assert reversed_turns["mean_deg"] > 20.0


@pytest.mark.heavy
def test_incomplete_trial_is_rejected(tmp_path: Path) -> None:
    trial = write_trial(tmp_path / "key0", 20)
    with pytest.raises(InputError, match="20 poses for 21 frames"):
        trial_turns_deg(trial, 21)
    (trial / "contact_masks.npy").unlink()
    with pytest.raises(InputError, match=r"contact_masks.npy: cannot be read"):
        read_clips(trial)
    np.save(trial / "contact_masks.npy", np.ones((20, 320, 240), bool))
    with pytest.raises(InputError, match="no part of any frame is without contact"):
        read_clips(trial)
    for poses, text in ((np.full((20, 4, 4), np.nan), "not a rigid transform"), (np.eye(4), "not .N, 4, 4."),
                        (np.array([about_z(0.0)] * 3), "3 poses for 20 frames")):  # fmt: skip
        np.save(trial / "true_start_T_currs.npy", poses)
        with pytest.raises(InputError, match=text):
            trial_turns_deg(trial, 20)
    (trial / "true_start_T_currs.npy").write_bytes(b"no array")
    with pytest.raises(InputError, match="cannot be read as an array"):
        trial_turns_deg(trial, 20)
