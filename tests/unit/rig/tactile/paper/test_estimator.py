"""The paper's estimators: sign, unwrapping, window, refusals, and the published ones' faults."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.estimators import (
    DEFAULT_ESTIMATOR,
    ESTIMATORS,
    MATCHERS,
    PEERS,
    PUBLISHED,
    choose_estimator,
)
from rig.tactile.sample import SlipSample, State, TactileEstimator

Image = NDArray[np.uint8]
Draw = Callable[..., Image]

MENDED = ["skeleton", "ellipse", "pca"]
PERIOD_NS = 16_666_667
# Skeletons lean towards rows and diagonals of pixels, more so for wide contacts.
TOLERANCE_DEG = {"skeleton": 4.0, "ellipse": 1.0, "pca": 1.0}


def run(estimator: TactileEstimator, images: Iterable[Image]) -> list[SlipSample]:
    return [estimator.update(image, i * PERIOD_NS) for i, image in enumerate(images)]


def angles(samples: Iterable[SlipSample]) -> list[float]:
    found = [sample.angle_deg for sample in samples]
    assert all(angle is not None for angle in found)
    return [angle for angle in found if angle is not None]


def test_the_names_are_the_contracts() -> None:
    assert set(ESTIMATORS) == {
        "slip", "skeleton", "ellipse", "pca", "skeleton-published", "ellipse-published", "pca-published",
        "ecc", "polar", "kolamuri", "anglenet", "toskov",
    }  # fmt: skip
    assert DEFAULT_ESTIMATOR == "slip"


def test_an_unknown_name_is_answered_with_the_names(blank: Image) -> None:
    with pytest.raises(InputError, match="skeleton-published"):
        choose_estimator("skeletton").make(blank)


@pytest.mark.parametrize("window", [0, -1, 101])
def test_a_window_out_of_range_is_an_input_error(blank: Image, window: int) -> None:
    with pytest.raises(InputError, match="1 to 100"):
        choose_estimator("pca", window).make(blank)


@pytest.mark.parametrize("name", MENDED)
@pytest.mark.parametrize("start_deg", [-10.0, 30.0, 80.0, 170.0])
@pytest.mark.parametrize("turn_deg", [25.0, -25.0])
def test_a_turn_keeps_size_and_sign_wherever_it_begins(
    press: Draw, blank: Image, name: str, start_deg: float, turn_deg: float
) -> None:
    turns = np.linspace(0, turn_deg, 9)
    images = (press(start_deg + turn, half_axes=(95.0, 20.0)) for turn in turns)
    found = angles(run(choose_estimator(name, 1).make(blank), images))
    assert found[-1] - found[0] == pytest.approx(turn_deg, abs=TOLERANCE_DEG[name])
    assert np.abs(np.diff(found)).max() < 15


def test_angles_pass_180_without_a_jump(press: Draw, blank: Image) -> None:
    found = angles(run(choose_estimator("ellipse", 1).make(blank), (press(a) for a in range(0, 400, 20))))
    assert np.diff(found) == pytest.approx(np.full(19, 20.0), abs=1.5)


@pytest.mark.parametrize("window", range(2, 11))
def test_the_window_is_the_mean_of_the_last_angles(press: Draw, blank: Image, window: int) -> None:
    images = [press(4.0 * i) for i in range(14)]
    single = angles(run(choose_estimator("pca", 1).make(blank), images))
    mean = angles(run(choose_estimator("pca", window).make(blank), images))
    expected = [np.mean(single[max(0, i + 1 - window) : i + 1]) for i in range(14)]
    assert mean == pytest.approx(expected)


def test_a_frame_given_twice_counts_once(press: Draw, blank: Image) -> None:
    once, twice = choose_estimator("pca", 3).make(blank), choose_estimator("pca", 3).make(blank)
    for i in range(6):
        image = press(5.0 * i)
        sample = once.update(image, i * PERIOD_NS)
        assert twice.update(image, i * PERIOD_NS).angle_deg == sample.angle_deg
        repeated = twice.update(image, i * PERIOD_NS)
        late = twice.update(press(70), i * PERIOD_NS - 1)
        assert repeated.angle_deg == late.angle_deg == sample.angle_deg
        assert "axis" in repeated.skipped


@pytest.mark.parametrize("name", MENDED)
def test_contact_comes_goes_and_comes_back(press: Draw, blank: Image, name: str) -> None:
    estimator = choose_estimator(name, 2).make(blank)
    frames = [press(a) for a in (None, 10, 10, None, None, 40, 40, 40)]
    samples = run(estimator, frames)
    assert [s.state for s in samples] == [
        State.NO_CONTACT, State.TRACKING, State.TRACKING, State.NO_CONTACT,
        State.NO_CONTACT, State.REKEYED, State.TRACKING, State.TRACKING,
    ]  # fmt: skip
    refused = [s for s in samples if s.state is State.NO_CONTACT]
    assert all(s.angle_deg is None and s.contact_area_px == 0 and s.skipped for s in refused)
    assert samples[5].angle_deg == pytest.approx(samples[7].angle_deg, abs=0.5), "the window began afresh"
    assert samples[5].angle_deg == pytest.approx(40, abs=TOLERANCE_DEG[name] + 1)


def test_a_contact_that_returns_continues_in_the_nearest_branch(press: Draw, blank: Image) -> None:
    shown = [*range(0, 201, 20), None, 30]
    samples = run(choose_estimator("ellipse", 1).make(blank), (press(a) for a in shown))
    assert samples[-3].angle_deg == pytest.approx(200, abs=2)
    assert samples[-1].angle_deg == pytest.approx(210, abs=2)


@pytest.mark.parametrize("name", MENDED)
def test_a_round_contact_is_refused(press: Draw, blank: Image, name: str) -> None:
    samples = run(choose_estimator(name).make(blank), (press(a, half_axes=(60.0, 57.0)) for a in (0, 20, 40)))
    assert {s.state for s in samples} == {State.UNOBSERVABLE}
    assert all(s.angle_deg is None and s.contact_area_px > 0 for s in samples)


def test_a_refused_stretch_leaves_nothing_in_the_window(press: Draw, blank: Image) -> None:
    frames = [press(0), press(0), press(0, half_axes=(60.0, 58.0)), press(30), press(30)]
    samples = run(choose_estimator("ellipse", 5).make(blank), frames)
    assert samples[2].state is State.UNOBSERVABLE
    assert samples[3].state is State.TRACKING
    assert samples[3].angle_deg == pytest.approx(samples[4].angle_deg, abs=0.5)


def test_true_pixels_are_measured_where_the_published_script_stretches(press: Draw, blank: Image) -> None:
    images = [press(a, half_axes=(90.0, 20.0)) for a in (0, 45)]
    mended = angles(run(choose_estimator("ellipse", 1).make(blank), images))
    published = angles(run(choose_estimator("ellipse-published", 1).make(blank), images))
    assert mended[1] - mended[0] == pytest.approx(45, abs=0.7)
    # atan(tan(45 deg) * 240 / 256), and without a sign.
    assert published == pytest.approx([0, 43.15], abs=0.8)


def test_the_published_script_folds_a_turn_through_zero(press: Draw, blank: Image) -> None:
    images = [press(a, half_axes=(90.0, 20.0)) for a in (-10, 15)]
    assert angles(run(choose_estimator("pca-published", 1).make(blank), images))[1] == pytest.approx(
        5, abs=1.5
    )
    mended = angles(run(choose_estimator("pca", 1).make(blank), images))
    assert mended[1] - mended[0] == pytest.approx(25, abs=0.7)


@pytest.mark.parametrize("name", [n for n in ESTIMATORS if n.endswith(PUBLISHED)])
def test_the_published_scripts_answer_any_contact(press: Draw, blank: Image, name: str) -> None:
    frames = [press(None), press(0, half_axes=(60.0, 58.0)), press(10), press(10), press(None)]
    samples = run(choose_estimator(name).make(blank), frames)
    assert all(sample.angle_deg is not None for sample in samples[1:4])
    assert samples[0].state is samples[4].state is State.NO_CONTACT
    assert samples[0].angle_deg is samples[4].angle_deg is None


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if name not in ("slip", *MATCHERS, *PEERS)])
def test_the_cost_of_each_stage_is_told(press: Draw, blank: Image, name: str) -> None:
    bare, touched = run(choose_estimator(name, 1).make(blank), [press(None), press(10)])
    assert set(touched.stage_s) == {"contact", "axis", "filter"}
    assert all(duration >= 0 for duration in touched.stage_s.values())
    assert touched.skipped == ()
    assert set(bare.stage_s) | set(bare.skipped) == {"contact", "axis", "filter"}
    assert not set(bare.stage_s) & set(bare.skipped)


CONTENT = st.one_of(
    hnp.arrays(np.uint8, (40, 30, 3)),
    st.integers(0, 255).map(lambda grey: np.full((40, 30, 3), grey, np.uint8)),
    st.integers(0, 3599).map(lambda i: np.eye(1, 3600, i, dtype=np.uint8).reshape(40, 30, 3) * np.uint8(255)),
    st.tuples(st.integers(0, 39), st.integers(0, 29)).map(
        lambda corner: np.pad(
            np.full((40 - corner[0], 30 - corner[1], 3), 255, np.uint8),
            ((corner[0], 0), (corner[1], 0), (0, 0)),
        )
    ),
)


@pytest.mark.parametrize("name", ESTIMATORS)
@settings(max_examples=60)
@given(background=CONTENT, frames=st.lists(CONTENT, min_size=1, max_size=5))
def test_any_content_is_answered_or_flagged(name: str, background: Image, frames: list[Image]) -> None:
    for frame in frames:
        frame.setflags(write=False)
    for sample in run(choose_estimator(name).make(background), frames):
        answered = sample.state in (State.TRACKING, State.REKEYED) or PUBLISHED in name
        assert answered or sample.angle_deg is None
        assert sample.angle_deg is None or np.isfinite(sample.angle_deg)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize(
    "image", [np.zeros((5, 5), np.uint8), np.zeros((320, 240, 3)), np.zeros((9, 9, 3), np.uint8)]
)
def test_what_is_no_frame_is_an_input_error(name: str, blank: Image, image: Image) -> None:
    with pytest.raises(InputError, match="tactile frame"):
        choose_estimator(name).make(blank).update(image, 0)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_same_frames_give_the_same_answers(press: Draw, blank: Image, name: str) -> None:
    images = [press(3.0 * i, noise=3.0, seed=i) for i in range(8)]
    first, second = (
        [(s.state, s.angle_deg) for s in run(choose_estimator(name).make(blank), images)] for _ in range(2)
    )
    assert first == second
