"""A frame stamped an hour ahead affects only that frame: in lifts, replays and other frames."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.frames.estimates import apply_zero, estimate_series, figures
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State
from support.marks import heavy
from support.recordings import written_again

pytestmark = pytest.mark.heavy

Image = NDArray[np.uint8]
HOUR_NS = 3600 * 10**9
STORED = Path(__file__).parents[3] / "data" / "stored_trial"


ANGLES = [20.0] * 8 + list(np.linspace(20.0, 36.0, 41)[1:]) + [36.0] * 10
"""Angles of a pressed bar that turns, deg."""


@pytest.mark.parametrize("topic", ["/image/SIM-D0001", "/image/SIM-C0001"])
def test_lift_continues_and_reports_the_frame_with_jumped_time(tmp_path: Path, topic: str) -> None:
    session = shutil.copytree(STORED, tmp_path / "trial")
    [stored] = run_replay(stored_trial(session), jobs=1).rows
    half = min(stored.frames.values()) // 2
    written_again(session / stored.recording, late=(topic, half, HOUR_NS))
    [again] = run_replay(stored_trial(session), jobs=1).rows
    source = "camera" if "C0001" in topic else topic.removeprefix("/image/")
    assert stored.jumped is None
    assert again.jumped == {source: 1}
    assert again.frames == stored.frames
    assert again.final_estimate_deg == pytest.approx(stored.final_estimate_deg, abs=0.2)
    assert again.final_truth_deg == pytest.approx(stored.final_truth_deg, abs=0.2)
    assert again.answered == pytest.approx(stored.answered, abs=0.05)
    assert len(read_finished_lifts(session)) == 1


@pytest.mark.parametrize("name", ["slip", *heavy("ecc", "pca")])
def test_frames_of_other_sources_continue_and_the_jumped_frame_is_reported(
    press: Callable[..., Image], blank: Image, name: str
) -> None:
    angles = [20.0] * 6 + ANGLES
    images = [press(angle, seed=i, half_axes=(80.0, 25.0)) for i, angle in enumerate(angles)]
    times_ns = [round(i * 1e9 / 60) + (HOUR_NS if i == 26 else 0) for i in range(len(images))]
    frames = [
        TimedFrame(str(i), FrameTime(f"{t / 1e9:.6f}", t), image)
        for i, (t, image) in enumerate(zip(times_ns, images, strict=True))
    ]
    series = FrameSeries("drawn", lambda: iter(frames))
    estimate = apply_zero(estimate_series(series, choose_estimator(name, None).make(blank, None)), None)
    assert [sample.jumped for sample in estimate.samples] == [i == 26 for i in range(len(images))]
    assert estimate.samples[26].state is State.LOST
    assert estimate.samples[-1].angle_deg == pytest.approx(16.0, abs=1.5)
    found = figures(estimate)
    assert (found.jumped, found.unreadable) == (1, 0)


@pytest.mark.parametrize("name", ["slip", "ecc", "ellipse", "pca-published"])
@pytest.mark.parametrize(
    ("place", "jump_s"),
    [
        (10, 3600),
        (40, -1),
        *heavy((20, -3600), (20, 1), (57, 3600)),
    ],
)
def test_estimator_gives_equal_angles_on_all_frames_but_the_one_with_the_wrong_time(
    press: Callable[..., Image], blank: Image, name: str, place: int, jump_s: float
) -> None:
    images = [press(angle, seed=i, half_axes=(80.0, 25.0)) for i, angle in enumerate(ANGLES)]
    times_ns = [round((5.0 + i / 60) * 1e9) for i in range(len(images))]
    choice = choose_estimator(name, None)
    with_jump, without = choice.make(blank, None), choice.make(blank, None)
    for i, (image, time_ns) in enumerate(zip(images, times_ns, strict=True)):
        if i == place:
            sample = with_jump.update(image, time_ns + round(jump_s * 1e9))
            assert (sample.state, sample.angle_deg, sample.jumped) == (State.LOST, None, True)
        else:
            sample, expected = with_jump.update(image, time_ns), without.update(image, time_ns)
            assert (sample.state, sample.angle_deg) == (expected.state, expected.angle_deg)
            assert sample.sigma_deg == expected.sigma_deg


@pytest.mark.parametrize("place", [0, 1])
def test_estimator_recovers_from_a_wrong_time_before_the_frame_rate_is_known(
    press: Callable[..., Image], blank: Image, place: int
) -> None:
    estimator = choose_estimator("slip", None).make(blank, None)
    samples = []
    for i, angle in enumerate(ANGLES):
        time_ns = round(i * 1e9 / 60) + (HOUR_NS if i == place else 0)
        samples.append(estimator.update(press(angle, seed=i, half_axes=(80.0, 25.0)), time_ns))
        assert samples[-1].time_ns == time_ns
    found = [sample.angle_deg for sample in samples[3:]]
    assert None not in found
    assert found[-1] - found[0] == pytest.approx(16.0, abs=1.0)
