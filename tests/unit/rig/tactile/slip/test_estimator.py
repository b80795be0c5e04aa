"""The estimator slip on a drawn sensor whose gradients turn with the object, and on real pictures."""

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.images import read_image
from rig.tactile.contact.background import auto_background
from rig.tactile.contact.gate import Region
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.outline import Outline
from rig.tactile.slip.tearing import Tearing
from rig.tactile.slip.tracker import Tracked, Tracker
from support.marks import heavy

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
PERIOD_NS = 16_666_667
EDGE = (80.0, 25.0)
REST = 12
"""Frames at rest before a turn: a contact settles in ten."""


def run(tracker: SlipEstimator, images: Iterable[Image], period_ns: int = PERIOD_NS) -> list[SlipSample]:
    return [tracker.update(image, i * period_ns) for i, image in enumerate(images)]


def turned(samples: list[SlipSample]) -> float:
    """Turn from the settled contact to the last frame."""
    start, end = samples[REST - 1].angle_deg, samples[-1].angle_deg
    return end - start


def turned_since_settled(samples: list[SlipSample]) -> float:
    """Turn from the first frame of the settled contact to the last frame."""
    start = next(sample for sample in samples if sample.settled and sample.angle_deg is not None)
    return samples[-1].angle_deg - start.angle_deg


def lift(
    press: Draw, turn_deg: float, start_deg: float = 20.0, steps: int = 12, **drawn: object
) -> list[Image]:
    angles = [start_deg] * REST + list(np.linspace(start_deg, start_deg + turn_deg, steps + 1)[1:])
    return [press(angle, seed=i, **{"half_axes": EDGE, **drawn}) for i, angle in enumerate(angles)]


@pytest.mark.heavy
@given(
    start=st.floats(-180, 180),
    turn=st.floats(-45, 45),
    half_axes=st.sampled_from([(80.0, 20.0), (90.0, 35.0), (60.0, 25.0)]),
    size=st.sampled_from([(240, 320), (320, 240)]),
)
def test_rotation_is_measured_from_any_initial_angle(
    press: Draw, start: float, turn: float, half_axes: tuple[float, float], size: tuple[int, int]
) -> None:
    center = (size[0] / 2, size[1] / 2)
    # 16 frames: at most 170 degrees per second, as the estimator turns by at most 200.
    images = lift(press, turn, start, steps=16, half_axes=half_axes, size=size, center=center)
    samples = run(SlipEstimator(press(None, size=size, noise=0.0)), images)
    sigma = samples[-1].sigma_deg
    assert turned(samples) == pytest.approx(turn, abs=max(0.3, 3 * sigma))
    assert turned(samples) == pytest.approx(turn, abs=1.0)


@pytest.mark.heavy
@given(factor=st.integers(2, 8), repeats=st.integers(1, 8), offset=st.integers(0, 7), turn=st.floats(-30, 30))
def test_angle_does_not_depend_on_the_frame_rate(
    press: Draw, blank: Image, factor: int, repeats: int, offset: int, turn: float
) -> None:
    """Frames are left out, then each is repeated. Rest, turn and rest after it take 0.8 s each."""
    angles = np.interp(np.arange(144) * PERIOD_NS / 1e9, [0.8, 1.6], [20.0, 20.0 + turn])
    images = [press(angle, seed=i, half_axes=EDGE) for i, angle in enumerate(angles)]
    complete = run(SlipEstimator(blank), images)
    images, period_ns = images[offset % factor :: factor], factor * PERIOD_NS // repeats
    fewer = run(SlipEstimator(blank), [image for image in images for _ in range(repeats)], period_ns)
    assert abs(turned_since_settled(fewer) - turned_since_settled(complete)) < fewer[-1].sigma_deg
    assert abs(turned_since_settled(fewer) - turn) < 2 * fewer[-1].sigma_deg


@pytest.mark.heavy
@pytest.mark.parametrize("light", [(0.8, 1.0, 1.15), (1.15, 0.8, 0.9)])
def test_drifting_light_changes_neither_angle_nor_rate(
    press: Draw, blank: Image, light: tuple[float, float, float]
) -> None:
    samples = run(SlipEstimator(blank), lift(press, 30.0, steps=30, light=light))
    assert turned(samples) == pytest.approx(30.0, abs=0.4)
    assert samples[-1].rate_deg_s == pytest.approx(60.0, abs=3.0)


def test_shift_of_a_contact_is_measured_and_nothing_without_one(press: Draw, blank: Image) -> None:
    places = [(120.0, 160.0)] * REST + [(120.0 + i, 160.0 - 2 * i) for i in range(1, 9)]
    images = [press(25.0, half_axes=EDGE, center=place, seed=i) for i, place in enumerate(places)]
    bare, *_, last = run(SlipEstimator(blank), [press(None), *images])
    assert (bare.state, bare.angle_deg) == (State.NO_CONTACT, None)
    assert "alignment" in bare.skipped
    assert "alignment" not in bare.stage_s
    assert last.shift_px == pytest.approx((8.0, -16.0), abs=1.0)
    assert last.contact_area_px > 0.0


@pytest.mark.heavy
def test_angle_does_not_depend_on_frame_rate_and_dropped_frames(press: Draw, blank: Image) -> None:
    images = lift(press, 24.0, steps=24)
    every = turned(run(SlipEstimator(blank), images))
    second = turned(run(SlipEstimator(blank), images[:REST] + images[REST + 1 :: 2], 2 * PERIOD_NS))
    few = turned(run(SlipEstimator(blank), images[:REST] + images[REST + 5 :: 6], 6 * PERIOD_NS))
    assert second == pytest.approx(every, abs=0.05)
    assert few == pytest.approx(every, abs=0.1)


@pytest.mark.heavy
def test_rotation_beyond_360_degrees_is_unwrapped(press: Draw, blank: Image) -> None:
    samples = run(SlipEstimator(blank), lift(press, 400.0, steps=130))
    assert turned(samples) == pytest.approx(400.0, abs=4.0)
    assert any(sample.state is State.REKEYED for sample in samples)


@pytest.mark.heavy
@pytest.mark.parametrize("half_axes", [(60.0, 60.0), (45.0, 45.0)])
def test_smooth_round_contact_is_refused_from_its_second_frame_on(
    press: Draw, blank: Image, half_axes: tuple[float, float]
) -> None:
    """The first frame is where a contact begins to count; its first keyframe shows whether it can be seen."""
    samples = run(SlipEstimator(blank), lift(press, 30.0, half_axes=half_axes))
    assert {sample.state for sample in samples[1:]} == {State.UNOBSERVABLE}
    assert all(sample.angle_deg is None for sample in samples[1:])


@pytest.mark.heavy
def test_repeated_and_late_frames_are_skipped_and_change_no_later_angle(press: Draw, blank: Image) -> None:
    images = lift(press, 20.0, steps=20)
    plain, tracker, samples = run(SlipEstimator(blank), images), SlipEstimator(blank), []
    for i, image in enumerate(images):
        samples.append(tracker.update(image, i * PERIOD_NS))
        again = tracker.update(image, i * PERIOD_NS + PERIOD_NS // 2)
        late = tracker.update(images[0], (i - 3) * PERIOD_NS)
        assert again.angle_deg is not None
        assert (late.state, late.angle_deg) == (State.LOST, None)
        assert again.skipped == late.skipped == SlipEstimator.stages
    assert samples[-1].angle_deg == pytest.approx(plain[-1].angle_deg, abs=0.02)


@pytest.mark.heavy
def test_torn_frame_does_not_end_tracking(press: Draw, blank: Image) -> None:
    images = lift(press, 20.0, steps=20)
    torn = [image.copy() for image in images]
    torn[REST + 6][140:] = 128
    torn[REST + 10] = np.roll(torn[REST + 10], 60, axis=0)
    samples = run(SlipEstimator(blank), torn)
    clean = run(SlipEstimator(blank), images)
    assert samples[-1].angle_deg == pytest.approx(clean[-1].angle_deg, abs=0.1)
    for sample, honest in zip(samples, clean, strict=True):
        assert sample.angle_deg is None or abs(sample.angle_deg - honest.angle_deg) < 3.0  # type: ignore[operator]


@pytest.mark.heavy
def test_contact_that_left_and_returned_is_rekeyed_with_large_sigma(press: Draw, blank: Image) -> None:
    gone = [press(None, seed=i) for i in range(60)]
    # The angle changes by 200 degrees per second at most, so the contact is held until it has arrived.
    held = [press(80.0, seed=100 + i, half_axes=EDGE) for i in range(90)]
    again = [*lift(press, 10.0, start_deg=70.0), *held]
    samples = run(SlipEstimator(blank), [*lift(press, 10.0), *gone, *again])
    back = samples[REST + 12 + 60 :]
    assert back[0].state is State.REKEYED
    sigmas = [sample.sigma_deg for sample in (samples[REST + 11], back[0], back[-1])]
    assert sigmas[0] < 2.0
    for sigma, unseen in zip(sigmas[1:], (back[0].unseen_deg, back[-1].unseen_deg), strict=True):
        assert sigma > unseen > 20.0, "how far it turned in between was not seen"
    assert turned(samples) == pytest.approx(60.0, abs=2 * sigmas[2])


@pytest.mark.parametrize("gap_s", [0.5, 1.0, 2.0])
def test_contact_is_followed_across_distant_frames(press: Draw, blank: Image, gap_s: float) -> None:
    turns = [0.0] * 6 + [3.0, 11.0, 4.0, -8.0, -15.0, -2.0]
    images = [press(20.0 + turn, seed=i, half_axes=EDGE) for i, turn in enumerate(turns)]
    samples = run(SlipEstimator(blank), images, round(gap_s * 1e9))
    for sample, turn in zip(samples[1:], turns[1:], strict=True):
        assert sample.angle_deg is None if sample.jumped else sample.angle_deg == pytest.approx(turn, abs=0.5)


@pytest.mark.heavy
@given(frames=st.lists(st.tuples(st.floats(-90, 90), st.floats(0.01, 0.4)), min_size=2, max_size=12))
@settings(max_examples=10)
def test_angle_changes_by_at_most_200_degrees_a_second_with_a_finite_sigma(
    press: Draw, blank: Image, frames: list[tuple[float, float]]
) -> None:
    tracker, time_ns = SlipEstimator(blank), 0
    samples = run(tracker, lift(press, 0.0)[:REST])
    time_ns = samples[-1].time_ns
    for i, (angle, after_s) in enumerate(frames):
        time_ns += round(after_s * 1e9)
        samples.append(tracker.update(press(angle, seed=i, half_axes=EDGE), time_ns))
    answered = [sample for sample in samples if sample.angle_deg is not None]
    for before, after in pairwise(answered):
        step_s = (after.time_ns - before.time_ns) * 1e-9
        assert abs(after.angle_deg - before.angle_deg) <= 200.0 * step_s + 1e-6  # type: ignore[operator]
    for sample in answered:
        assert math.isfinite(sample.sigma_deg)
        assert 0.0 <= sample.unseen_deg <= sample.sigma_deg
        assert sample.sigma_deg > 0.0


def test_sigma_grows_when_the_frame_disagrees_with_its_keyframes(press: Draw, blank: Image) -> None:
    rest = lift(press, 0.0)[:REST]
    other = [press(20.0, seed=50 + i, half_axes=(55.0, 40.0)) for i in range(6)]
    samples = run(SlipEstimator(blank), [*rest, *other])
    sigmas = [sample.sigma_deg or math.inf for sample in samples[REST - 1 :]]
    assert min(sigmas[1:]) > 2.0 * sigmas[0]


def test_a_loss_however_large_adds_at_most_nine_degrees_to_sigma(
    press: Draw, blank: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow = Tracker.follow

    def lost(*arguments: Any) -> Tracked | None:
        tracked = follow(*arguments)
        return tracked and replace(tracked, worst_loss=50.0)

    monkeypatch.setattr(Tracker, "follow", lost)
    # The outline of a long contact would bound sigma too.
    monkeypatch.setattr(Outline, "correct", lambda self, angle_rad, variance, mask: (angle_rad, variance))
    assert 9.0 < run(SlipEstimator(blank), lift(press, 0.0))[-1].sigma_deg < 9.5


def test_running_every_stage_gives_the_same_angles(press: Draw, blank: Image) -> None:
    images = lift(press, 25.0, steps=25)
    lean, full = run(SlipEstimator(blank), images), run(SlipEstimator(blank, skip=False), images)
    assert any("texture" in sample.skipped for sample in lean)
    for less, more in zip(lean, full, strict=True):
        assert (less.state, less.angle_deg, less.sigma_deg) == (more.state, more.angle_deg, more.sigma_deg)
        assert not more.skipped
        assert set(more.stage_s) == set(SlipEstimator.stages)


def test_pixel_aspect_is_corrected(press: Draw, blank: Image) -> None:
    size = (264, 320)  # the same picture, stretched by a tenth
    stretched = [np.ascontiguousarray(_stretched(image, size)) for image in lift(press, 30.0, steps=15)]
    background = _stretched(blank, size)
    known = turned(run(SlipEstimator(background, aspect=240 / 264), stretched))
    unknown = turned(run(SlipEstimator(background), stretched))
    assert known == pytest.approx(30.0, abs=0.3)
    assert abs(unknown - 30.0) > 0.5


def _stretched(image: Image, size: tuple[int, int]) -> Image:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("size", "most_deg"), [((60, 80), 1.2), ((480, 640), 0.8), *heavy(((120, 160), 0.8), ((640, 480), 0.8))]
)
def test_any_image_size_is_accepted(press: Draw, size: tuple[int, int], most_deg: float) -> None:
    """The smallest image has no fine copy, and its contact is drawn with a quarter of the strength."""
    scale = max(size) / 320
    shape = {"size": size, "center": (size[0] / 2, size[1] / 2), "half_axes": (70 * scale, 22 * scale)}
    images = lift(press, 20.0, noise=1.0, strength=scale, **shape)
    samples = run(SlipEstimator(press(None, size=size, noise=0.0)), images)
    assert turned(samples) == pytest.approx(20.0, abs=most_deg)


def test_restarted_stream_is_followed(press: Draw, blank: Image) -> None:
    images, hour_ns = lift(press, 16.0), 3_600_000_000_000
    tracker = SlipEstimator(blank)
    samples = [tracker.update(images[0], hour_ns)]
    samples += [tracker.update(image, i * PERIOD_NS) for i, image in enumerate(images[1:])]
    assert turned(samples) == pytest.approx(16.0, abs=1.0)


def test_jump_within_a_frame_is_not_reported_as_certain(press: Draw, blank: Image) -> None:
    """An edge resembles itself elsewhere, so a rotation by 60 degrees within a frame is not followed."""
    jumped = [press(80.0, seed=100 + i, half_axes=EDGE) for i in range(3)]
    samples = run(SlipEstimator(blank), [*lift(press, 0.0), *jumped])
    for sample in samples[-3:]:
        assert sample.angle_deg is None or (sample.sigma_deg is not None and sample.sigma_deg > 10.0)


def test_other_contact_for_a_third_of_a_second_increases_sigma_by_less_than_its_rate_allows(
    press: Draw, blank: Image
) -> None:
    rest = lift(press, 0.0)
    other = [press(80.0, seed=i, half_axes=(40.0, 38.0), center=(150.0, 200.0)) for i in range(12)]
    last = run(SlipEstimator(blank), [*rest, *other, *rest])[-1]
    assert last.sigma_deg < 25.0


def test_codec_refresh_is_not_a_contact(press: Draw, blank: Image) -> None:
    """After a refresh of a video codec, blocks all over the frame are a little brighter or darker."""
    rng = np.random.default_rng(7)
    blocks = rng.normal(0.0, 0.022, (40, 30, 3)) * rng.gamma(2.0, 0.5, (40, 30, 1))
    change = 1.0 + cv2.resize(blocks, (240, 320), interpolation=cv2.INTER_LINEAR)
    fresh = [np.clip(np.rint(press(None, seed=i) * change), 0, 255).astype(np.uint8) for i in range(12)]
    samples = run(SlipEstimator(blank), [*fresh, *lift(press, 0.0)])
    assert {sample.state for sample in samples[:12]} == {State.NO_CONTACT}
    assert samples[-1].sigma_deg < 1.0


@pytest.mark.parametrize(("areas", "torn"), [((100, 100), False), ((100, 160), True), ((160, 100), True)])
def test_area_change_by_half_counts_as_a_torn_frame(areas: tuple[int, int], torn: bool) -> None:
    tearing, mask = Tearing(), np.ones((4, 4), np.uint8)
    assert not tearing.update(Region(mask, areas[0], 0.1))
    assert tearing.update(Region(mask, areas[1], 0.1)) == torn
    assert not tearing.update(Region(mask, areas[1], 0.1))


def held(background: Image, image: Image, frames: int = 14) -> list[SlipSample]:
    """Show one image repeatedly, each time with different noise."""
    tracker, rng = SlipEstimator(background), np.random.default_rng(0)
    noisy = (np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for _ in range(frames))
    return [tracker.update(picture, i * 16_666_667) for i, picture in enumerate(noisy)]


@pytest.mark.heavy
def test_balls_on_a_real_gel_are_refused(real_data: Path) -> None:
    folder = real_data / "gelsight_ball"
    background = read_image(folder / "background.png")
    balls = sorted(folder.glob("*mm_*.png"))
    assert len(balls) > 60
    for ball in balls[::8]:
        states = {sample.state for sample in held(background, read_image(ball))[1:]}
        assert states == {State.UNOBSERVABLE}, ball.name


def test_every_ball_pressed_into_a_real_digit_is_refused() -> None:
    folder = Path(os.environ.get("RIG_DIGIT_BALLS", ""))
    if not (folder / "circles.csv").is_file():
        pytest.skip("RIG_DIGIT_BALLS does not name the folder that digit_balls/rebuild.py makes")
    background = read_image(folder / "background.png")
    balls = sorted((folder / "frames").glob("*.png"))
    assert len(balls) == 31
    for ball in balls:
        states = {sample.state for sample in held(background, read_image(ball))[1:]}
        assert states == {State.UNOBSERVABLE}, ball.name


@pytest.mark.parametrize("panel", [1, 5, 9, *heavy(2, 3, 4, 6, 7, 8)])
def test_real_contact_at_rest_has_a_constant_angle(real_data: Path, panel: int) -> None:
    panels = [read_image(real_data / "aurova_figures" / "panels" / f"{i}_raw.png") for i in range(1, 10)]
    smallest = tuple(min(p.shape[axis] for p in panels) for axis in (0, 1))
    panels = [p[: smallest[0], : smallest[1]] for p in panels]
    samples = held(auto_background(panels), panels[panel - 1])
    assert samples[-1].state is State.TRACKING
    answered = [sample.angle_deg for sample in samples if sample.angle_deg is not None]
    assert len(answered) >= 10
    # Two of the nine are nearly round: their sigma is a third of a degree.
    assert all(abs(angle) < 1.0 for angle in answered)
