"""A public set with known turns, read from small synthetic copies of its layout."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from rig.benchmark.clips.labelled import read_clips
from rig.benchmark.clips.study import ClipsOptions, measure
from rig.benchmark.harness import Run
from rig.contract_checks import gel
from rig.frames.clips import trial_turns_deg
from rig.frames.series import make_background, read_frames
from support.command_line import rig
from support.public_sets import about_z, turns_deg, write_trial

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def tracking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trials of two objects."""
    root = tmp_path_factory.mktemp("TactileTracking")
    for name in ("key0", "bead3"):
        write_trial(root / name)
    return root


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


def test_background_uses_pixels_without_contact(tracking: Path) -> None:
    series = read_frames(tracking / "key0")
    assert any("contact_masks.npy" in note for note in series.notes)
    background, note = make_background(None, series)
    assert note == "background: the set's own"
    assert np.abs(background.astype(float) - gel(320, 240)).mean() < 3.0


def test_estimators_are_compared_with_the_known_turns(tracking: Path) -> None:
    for name in ("slip", "pca"):
        overall = measure(ClipsOptions(tracking / "key0", [name]), Run()).tables[1].records[0]["score"]
        assert overall.mean_deg < 3.0, name
        assert float(overall.within) >= 0.8
    done = rig("benchmark", "clips", tracking / "key0", "--estimator", "pca", "--reversed-turns", "--json")
    assert done.returncode == 0, done.stderr
    reversed_turns = json.loads(done.stdout)["estimators"]["pca"]["all"]
    assert reversed_turns["labels"] == 3
    assert reversed_turns["mean_deg"] > 20.0


def test_command_reads_a_trial(tracking: Path) -> None:
    done = rig("estimate", tracking / "key0", "--estimator", "pca", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert len(result["samples"]) == 40
    assert result["background"] == "background: the set's own"
    assert result["samples"][-1]["angle_deg"] == pytest.approx(turns_deg()[-1], abs=3.0)


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
