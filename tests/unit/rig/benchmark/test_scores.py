"""The benchmark's figures: errors, windows, onsets and limits, from angles written down by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.benchmark.estimators import contenders
from rig.results.scores import is_confidently_wrong, score_series
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State

Image = NDArray[np.uint8]
Press = Callable[..., Image]
FRAME_NS = 16_666_667


def test_lift_score_matches_the_contract() -> None:
    score = score_series(
        "t1/1",
        [0.0, 1.0, None, 4.0],
        [0.1, 0.6, None, 0.5],
        [0.0, 2.0, 3.0, None],
        np.array([True, True, False, False]),
    )
    assert score.re.mean_deg == pytest.approx(0.5)
    assert score.re_held.mean_deg == pytest.approx((0.0 + 1.0 + 2.0) / 3)  # the refused frame counts as 1.0
    assert score.answered == 0.75
    assert (score.sure, score.within) == (2, 2)


def test_many_lifts_give_the_mean_of_means_and_the_worst_lift() -> None:
    one = score_series("t1/1", [1.0, 3.0], [None, None], [0.0, 0.0])
    two = score_series("1/2", [4.0, 4.0], [None, None], [0.0, 0.0])
    score = contenders.score_all([one, two])
    assert (score.mare.mean_deg, score.mare.std_deg) == (3.0, 0.5)
    assert score.mare_elongated.mean_deg == 2.0
    assert (score.worst_deg, score.worst) == (4.0, "1/2")
    assert score.within_two_sigma is None
    assert score.event is None  # without rates


def test_missed_late_and_false_onsets_are_counted() -> None:
    result = [(0.2, 0.21), (0.2, 0.4), (0.2, None), (None, 0.3), (None, None), (0.5, 0.1)]
    lift = replace(score_series("t1/1", [0.0], [None], [0.0]), has_rates=True)
    lifts = [
        replace(lift, onset_truth_s=true, onset_estimate_s=found, onset_event_s=found)
        for true, found in result
    ]
    score = contenders.score_all(lifts)
    assert score.event == score.onset
    assert (score.onset.true, score.onset.missed, score.onset.false_alarms) == (4, 1, 2)
    assert str(score.onset.within) == "1 of 4"
    assert score.onset.error_s == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("error_deg", "sigma_deg", "wrong"),
    [
        (15.0, 4.0, True),  # a sigma above 3 degrees, but more than 3 sigma off
        (-15.0, 4.0, True),
        (15.0, 6.0, False),
        (9.0, 0.1, False),
        (10.0, 0.0, False),
        (10.1, 0.0, True),
        (90.0, None, False),
    ],
)
def test_more_than_10_degrees_and_3_sigma_off_is_confidently_wrong(
    error_deg: float, sigma_deg: float | None, wrong: bool
) -> None:
    assert is_confidently_wrong(error_deg, sigma_deg) is wrong
    score = score_series("t1/1", [error_deg] * 5, [sigma_deg] * 5, [0.0] * 5)
    assert score.wrong == 5 * wrong
    assert contenders.score_all([score, score]).wrong_lifts == 2 * wrong


@pytest.mark.parametrize("name", contenders.CONTENDERS)
def test_windows_after_one_pass_equal_the_estimator_run_with_that_window(
    name: str, press: Press, blank: Image
) -> None:
    turns = [None, 0, 0, 0, 0, 0, 0, 0, 3, 6, 9, None, 12, 15]
    frames = [press(turn, seed=i) for i, turn in enumerate(turns)]
    one_pass = contenders.make_unfiltered(blank, None, (name,))[name]
    samples = [one_pass.update(frame, i * FRAME_NS) for i, frame in enumerate(frames)]
    whole = choose_estimator(name).make(blank, None, 1)
    expected = [whole.update(frame, i * FRAME_NS).angle_deg for i, frame in enumerate(frames)]
    window = 2 if name not in ("slip", "ecc") else 1
    assert [s.angle_deg for s in contenders.filter_samples(name, samples, window)] == expected


@given(
    st.lists(st.one_of(st.none(), st.floats(-180, 180)), min_size=1, max_size=30),
    st.sampled_from(contenders.WINDOWS),
)
def test_window_adds_no_angles_to_refused_frames(angles: list[float | None], window: int) -> None:
    samples = [
        SlipSample(i * FRAME_NS, State.LOST if a is None else State.TRACKING, a) for i, a in enumerate(angles)
    ]
    made = contenders.filter_samples("ecc", samples, window)
    assert [s.angle_deg is None for s in made] == [a is None for a in angles]
    known = [a for a in angles if a is not None]
    assert all(min(known) - 1e-9 <= s.angle_deg <= max(known) + 1e-9 for s in made if s.angle_deg is not None)


def test_percentiles_are_in_milliseconds() -> None:
    durations = contenders.spread([0.001] * 98 + [0.003, 0.009])
    assert (durations.p50_ms, durations.max_ms, durations.count) == (1.0, 9.0, 100)
    assert contenders.spread([]).count == 0
