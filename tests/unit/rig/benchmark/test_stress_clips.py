"""Clips with known angles, their disturbances, and the estimator on them."""

import re

import numpy as np
import pytest

from drivers.errors import InputError
from fakes.studio.clips import Clip, Scene, opposite, render_clip
from rig.benchmark.estimators import stress
from rig.benchmark.estimators.stress import CONDITIONS, run_stress, stress_rows

SHORT = Scene("t1:1", angle_deg=6.0, rate_deg_s=60.0)


@pytest.fixture(scope="module")
def clip() -> Clip:
    return render_clip(SHORT)


def disturbed(clip: Clip, change: stress.Disturbance) -> Clip:
    return change(clip, np.random.default_rng(0))


def test_clip_rests_turns_rests_and_depends_on_its_scene_and_seed_only(clip: Clip) -> None:
    assert (clip.angle_deg[0], clip.angle_deg[-1]) == (0.0, 6.0)
    assert 5 <= (np.diff(clip.angle_deg) > 0).sum() <= 7
    assert len(clip.frames) == len(clip.time_ns) == len(clip.angle_deg)
    assert clip.frames[0].shape == clip.background.shape == (320, 240, 3)
    render_clip.cache_clear()
    again, other = render_clip(SHORT), render_clip(Scene("t1:1", 6.0, 60.0, seed=1))
    assert all(np.array_equal(a, b) for a, b in zip(clip.frames, again.frames, strict=True))
    assert not np.array_equal(clip.frames[0], other.frames[0])
    assert render_clip(opposite(SHORT)).angle_deg[-1] == -6.0


@pytest.mark.parametrize("contact", ["t1:9", "t1", "nothing:0"])
def test_unknown_contact_is_an_input_error(contact: str) -> None:
    with pytest.raises(InputError):
        render_clip(Scene(contact))


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: c.name)
def test_disturbance_keeps_frames_times_and_truth_together(condition: stress.Condition, clip: Clip) -> None:
    changed, again = (disturbed(clip, condition.change) for _ in range(2))
    assert len(changed.frames) == len(changed.time_ns) == len(changed.angle_deg) > 0
    assert {f.dtype for f in changed.frames} == {np.dtype(np.uint8)}
    assert {f.shape for f in changed.frames} == {changed.background.shape}
    assert all(np.array_equal(a, b) for a, b in zip(changed.frames, again.frames, strict=True))
    if percent := re.fullmatch("LEDs (.*) % off since the background", condition.name):
        assert np.array_equal(changed.background, clip.background)
        for i in (0, -1):
            before, after = (of.frames[i][100:200, 80:160].mean(axis=(0, 1)) for of in (clip, changed))
            expected = 1.0 + float(percent[1]) / 100.0 * np.array(stress.LED_PATTERN)
            assert after / before == pytest.approx(expected, abs=0.02)


def test_disturbances_have_their_documented_effect(clip: Clip) -> None:
    darker = disturbed(clip, stress.drift(-0.2, (1, 1, 1))).frames
    assert float(darker[-1].mean()) == pytest.approx(0.8 * float(clip.frames[-1].mean()), rel=0.01)
    assert np.array_equal(darker[0], clip.frames[0])
    assert disturbed(clip, stress.resize(60, 80)).background.shape == (80, 60, 3)
    assert len(disturbed(clip, stress.every(2)).frames) == (len(clip.frames) + 1) // 2
    late = disturbed(clip, stress.late).time_ns
    assert sorted(late) == list(clip.time_ns) != list(late)
    doubled = disturbed(clip, stress.duplicate_frames)
    assert np.array_equal(doubled.frames[5], clip.frames[4])
    assert doubled.time_ns == clip.time_ns


def test_conditions_have_unique_names_and_all_have_tasks() -> None:
    names = [c.name for c in CONDITIONS]
    assert len(set(names)) == len(names) > 30
    assert set(stress.stress_tasks()) == {(c.group, contact) for c in CONDITIONS for contact in c.contacts}


@pytest.mark.heavy
def test_rotation_is_followed_and_a_ball_is_refused() -> None:
    turning = stress_rows(run_stress(0, ("slip",), ("size", "t1:1")))
    ours = {row.condition: row.score for row in turning if row.estimator == "slip"}
    assert set(ours) == {c.name for c in CONDITIONS if c.group == "size"}
    # it follows 30 degrees; the benchmark measures the error
    assert all(score.mare.mean_deg < 3.0 for score in ours.values())
    balls = stress_rows(run_stress(0, stress.NAMES, ("round", "3:0")))
    assert {row.estimator for row in balls} == set(stress.NAMES)
    assert all(row.refused for row in balls)
    assert [row.score.answered for row in balls if row.estimator == "slip"] == [0.0, 0.0]
