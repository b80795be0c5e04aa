"""Where keyframes are placed, how sure they are, and what no keyframe is taken of."""

import math
from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.tactile.contact.gate import Region
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.axis_check import anchor
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.height import Gradient
from rig.tactile.slip.kalman import unseen_variance
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.keys import ContactPose, Key
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.settling import Tearing
from rig.tactile.slip.tracker import KeyframeTracker, Tracked

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
EDGE = (80.0, 25.0)
REST = 12


def run(tracker: SlipEstimator, images: Iterable[Image], rate_hz: float = 60.0) -> list[SlipSample]:
    return [tracker.update(image, round(i * 1e9 / rate_hz)) for i, image in enumerate(images)]


def grown(
    press: Draw, share: float, angle_deg: float, seed: int, widest: tuple[float, float] = EDGE
) -> Image:
    """A contact of a share of its full size."""
    axes = (widest[0] * share, widest[1] * share)
    return press(angle_deg, seed=seed, half_axes=axes, strength=0.6 + 0.4 * share)


def turned(samples: list[SlipSample]) -> float:
    first, last = next(s for s in samples if s.angle_deg is not None), samples[-1]
    assert first.angle_deg is not None
    assert last.angle_deg is not None
    return last.angle_deg - first.angle_deg


@pytest.mark.parametrize("rate_hz", [10.0, 25.0])
def test_rotation_of_a_growing_contact_is_complete(press: Draw, blank: Image, rate_hz: float) -> None:
    """Renewed keyframes stand where their own frame is, not where the one before was."""
    shares, turns = np.linspace(0.45, 1.0, 14), np.linspace(0.0, 65.0, 14)
    images = [grown(press, s, 10.0 + t, i) for i, (s, t) in enumerate(zip(shares, turns, strict=True))]
    samples = run(SlipEstimator(blank), images, rate_hz)
    assert any(sample.state is State.REKEYED for sample in samples)
    assert turned(samples) == pytest.approx(65.0, abs=2.0)


def test_contact_growing_tenfold_keeps_angle_and_sigma(press: Draw, blank: Image) -> None:
    images = [grown(press, math.sqrt(s), 25.0, i) for i, s in enumerate(np.geomspace(0.1, 1.0, 40))]
    images += [grown(press, 1.0, 25.0, 100 + i) for i in range(REST)]
    samples = run(SlipEstimator(blank), images, 25.0)
    answered = [sample for sample in samples if sample.angle_deg is not None]
    assert len(answered) > 40
    assert answered[-1].contact_area_px > 4 * answered[0].contact_area_px, "the gel's skirts grow less"
    angles = np.array([sample.angle_deg for sample in answered], float)
    assert np.abs(angles - angles[0]).max() < 2.5
    rekeyed = [i for i, sample in enumerate(answered) if i and sample.state is State.REKEYED]
    assert rekeyed
    for i in rekeyed:
        before, after = answered[i - 1].sigma_deg, answered[i].sigma_deg
        assert before is not None
        assert after is not None
        assert after >= before


def field(angle_deg: float, half_axes: tuple[float, float], noise: float, seed: int = 0) -> GradientField:
    gradient, mask = dent(angle_deg, half_axes, noise, seed)
    return GradientField(gradient, mask)


def dent(
    angle_deg: float, half_axes: tuple[float, float], noise: float = 0.0, seed: int = 0
) -> tuple[Gradient, Image]:
    turn = math.radians(angle_deg)
    x, y = np.meshgrid(np.arange(60) - 29.5, 39.5 - np.arange(80))
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    reach = np.clip(1.0 - (along / half_axes[0]) ** 2 - (across / half_axes[1]) ** 2, 0.0, None)
    height = cv2.GaussianBlur(np.sqrt(reach).astype(np.float32) * 6.0, (0, 0), 1.5)
    down, across_slope = np.gradient(height)
    rng = np.random.default_rng(seed)
    gradient = across_slope + 1j * down + rng.normal(0, noise, height.shape) * (1 + 1j)
    return gradient.astype(np.complex64), (reach > 0.02).astype(np.uint8)


def test_chain_of_keyframes_follows_its_most_certain_one(press: Draw) -> None:
    """An older key that fits badly still tells something: both count by their variances."""
    first = make_keyframe(*dent(0.0, (18.0, 7.0)))
    newer = make_keyframe(*dent(10.0, (22.0, 12.0)))
    assert first is not None
    assert newer is not None
    tracker = KeyframeTracker(first, None, 0.0, 0.0)
    wrong_deg = 18.0
    pose = ContactPose(math.radians(wrong_deg), first.center_px)
    tracker.add_key(Key(newer, None, pose, math.radians(5.0) ** 2))
    tracked = tracker.track(field(12.0, (22.0, 12.0), 0.0), None, math.radians(17.0))
    assert tracked is not None
    alone_deg = wrong_deg + 2.0
    assert math.degrees(tracked.pose.angle_rad) < 0.5 * (12.0 + alone_deg)
    assert math.degrees(math.sqrt(tracked.variance)) < 5.0


def with_pivot(frame: Keyframe, share: float) -> Keyframe:
    """Return a keyframe as if an unknown pivot left open this share of a turn."""
    vars(frame)["pivot"] = share
    return frame


def test_pivot_uncertainty_grows_over_keyframes_and_shrinks_on_the_way_back() -> None:
    half_axes = (18.0, 7.0)
    first, newer = (make_keyframe(*dent(turn, half_axes)) for turn in (0.0, 10.0))
    assert first is not None
    assert newer is not None
    tracker = KeyframeTracker(with_pivot(first, 0.5), None, 0.0, 0.0)

    def turned_to(angle_deg: float) -> Tracked:
        tracked = tracker.track(field(angle_deg, half_axes, 0.0), None, math.radians(angle_deg))
        assert tracked is not None
        assert math.degrees(tracked.pose.angle_rad) == pytest.approx(angle_deg, abs=0.5)
        return tracked

    there = turned_to(10.0)
    assert math.degrees(there.pivot_rad) == pytest.approx(5.0, abs=0.3)
    tracker.add_key(Key(with_pivot(newer, 0.5), None, there.pose, 1e-4, there.pivot_rad))
    assert math.degrees(turned_to(20.0).pivot_rad) == pytest.approx(10.0, abs=0.6)
    assert math.degrees(turned_to(1.0).pivot_rad) == pytest.approx(0.5, abs=0.3)


def test_jump_beyond_the_rate_limit_is_not_recovered(press: Draw, blank: Image) -> None:
    """An edge looks the same elsewhere: 60 degrees within a frame are not told as certain."""
    rest = [press(10.0, seed=i, half_axes=EDGE) for i in range(30)]
    jumped = [press(70.0, seed=100 + i, half_axes=EDGE) for i in range(3)]
    before, after = (part := run(SlipEstimator(blank), rest + jumped))[:30], part[30:]
    assert turned(before) == pytest.approx(0.0, abs=0.1)
    for sample in after:
        assert sample.angle_deg is None or (sample.sigma_deg is not None and sample.sigma_deg > 10.0)


def test_no_keyframe_is_taken_of_a_torn_frame(press: Draw, blank: Image) -> None:
    images = [press(20.0, seed=i, half_axes=EDGE) for i in range(REST)]
    images += [press(20.0 + 2.0 * i, seed=50 + i, half_axes=EDGE) for i in range(12)]
    torn = images[REST + 4].copy()
    torn[:, 100:] = blank[:, 100:]  # half of the contact is of another moment
    images[REST + 4] = torn
    samples = run(SlipEstimator(blank), images)
    assert samples[REST + 4].state in (State.LOST, State.TRACKING)
    assert all(sample.state is not State.REKEYED for sample in samples[REST + 4 :])
    assert turned(samples) == pytest.approx(22.0, abs=0.3)


@pytest.mark.parametrize(("areas", "torn"), [((100, 100), False), ((100, 160), True), ((160, 100), True)])
def test_area_change_by_half_counts_as_a_torn_frame(areas: tuple[int, int], torn: bool) -> None:
    tearing = Tearing()
    mask = np.ones((4, 4), np.uint8)
    assert not tearing.update(Region(mask, areas[0], 0.1))
    assert tearing.update(Region(mask, areas[1], 0.1)) == torn
    assert not tearing.update(Region(mask, areas[1], 0.1))


def test_axis_of_a_changed_contact_is_ignored(drawn_mask: Draw) -> None:
    mask = drawn_mask(30.0, (60.0, 24.0)) // 255
    noted = anchor(mask, 0.0)
    assert noted is not None
    variance = math.radians(5.0) ** 2
    turned_mask = drawn_mask(33.0, (60.0, 24.0)) // 255
    angle, bounded = noted.corrected(turned_mask, 0.0, variance)
    assert math.degrees(angle) == pytest.approx(3.0, abs=0.4)
    assert bounded < variance
    half = mask.copy()
    half[:, 120:] = 0
    assert noted.corrected(half, 0.0, variance) == (0.0, variance)


def refreshed(
    press: Draw, seed: int, strength: float = 0.022, half_axes: tuple[float, float] | None = None
) -> Image:
    """A frame as after a codec's refresh: blocks all over it are a little brighter or darker."""
    rng = np.random.default_rng(seed)
    blocks = rng.normal(0.0, strength, (40, 30, 3)) * rng.gamma(2.0, 0.5, (40, 30, 1))
    wide = cv2.resize(blocks, (240, 320), interpolation=cv2.INTER_LINEAR)
    image = press(None, seed=seed) if half_axes is None else press(20.0, seed=seed, half_axes=half_axes)
    return np.clip(np.rint(image * (1.0 + wide)), 0, 255).astype(np.uint8)


def test_codec_refresh_is_not_a_contact(press: Draw, blank: Image) -> None:
    tracker = SlipEstimator(blank)
    images = [refreshed(press, 7) for _ in range(12)]
    rest = [press(20.0, seed=i, half_axes=EDGE) for i in range(REST)]
    samples = run(tracker, [*images, *rest])
    assert {sample.state for sample in samples[:12]} == {State.NO_CONTACT}
    assert samples[-1].sigma_deg is not None
    assert samples[-1].sigma_deg < 1.0


def test_short_gap_increases_sigma_by_the_unknown_rate(press: Draw, blank: Image) -> None:
    """Nothing fits for 0.35 s at rest: by then it may have turned by some degrees, not by thirty."""
    rest = [press(20.0, seed=i, half_axes=EDGE) for i in range(30)]
    other = [press(80.0, seed=i, half_axes=(40.0, 38.0), center=(150.0, 200.0)) for i in range(12)]
    samples = run(SlipEstimator(blank), [*rest, *other, *rest])
    assert samples[-1].sigma_deg is not None
    assert samples[-1].sigma_deg < 25.0


def test_unobserved_turn_is_bounded_by_rate_and_time() -> None:
    degrees = [
        math.degrees(math.sqrt(unseen_variance(math.radians(r), t))) for r, t in ((0, 0.1), (60, 0.1), (0, 9))
    ]
    assert degrees[0] == pytest.approx(1.5)
    assert degrees[1] == pytest.approx(7.5)
    assert degrees[2] == pytest.approx(180.0 / math.sqrt(12.0))
