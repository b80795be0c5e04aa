"""The contract of every estimator: for any frame, a valid estimate or an `InputError`."""

import math
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import ArmMode, ArmState, Image, Pose
from rig.contract_checks.options import MakeEstimator
from rig.tactile.sample import SlipSample, State, TactileEstimator

STEP_NS = 16_666_667
"""Time between two frames, at 60 frames per second."""
SIZES = [(8, 8), (9, 8), (13, 17), (8, 320), (320, 9), (41, 1601), (240, 320), (241, 319), (333, 250)]
REFUSED: list[NDArray[np.generic]] = [
    np.zeros((1, 1, 3), np.uint8), np.zeros((0, 0, 3), np.uint8), np.zeros((7, 320, 3), np.uint8),
    np.zeros((8000, 8, 3), np.uint8), np.zeros((8, 400, 3), np.uint8), np.zeros((240, 320), np.uint8),
    np.zeros((240, 320, 4), np.uint8), np.zeros((240, 320, 3), np.float32),
    np.zeros((240, 320, 3), np.uint16),
]  # fmt: skip
AT_REST, TURNING, STEP_DEG = 12, 20, 1.0
"""Frames of a contact at rest, then of a contact that rotates by STEP_DEG per frame."""
BAR_DEG = 20.0
LEAST_DEG, MOST_DEG = 2.0, 60.0
"""Range of the estimate of that rotation by 20 degrees. The contract fixes sign and unit, not accuracy."""


def gel(height: int, width: int, seed: int = 0) -> Image:
    """Return a gel without contact: light that varies over the gel, and noise."""
    y, x = np.mgrid[0 : 1 : complex(0, height), 0 : 1 : complex(0, width)]
    light = np.stack([170 - 130 * x, 40 + 110 * x * y, 120 - 70 * y], axis=-1)
    return np.clip(light + np.random.default_rng(seed).normal(0, 1.5, light.shape), 0, 255).astype(np.uint8)


def touched(height: int, width: int, share: float, seed: int) -> Image:
    """Return the gel under a block with a rough surface that covers a share of each side."""
    frame = gel(height, width, seed)
    rows, columns = (slice(0, max(1, round(side * share))) for side in (height, width))
    rough = np.random.default_rng(5).integers(0, 256, (1 + height // 8, 1 + width // 8, 3), dtype=np.uint8)
    frame[rows, columns] = cv2.resize(rough, (width, height), interpolation=cv2.INTER_CUBIC)[rows, columns]
    return frame


@cache
def pressed_bar(angle_deg: float, seed: int) -> Image:
    """Return the gel, 320 x 240 px, lit from three sides, under a bar at an angle, counter-clockwise."""
    y, x = np.mgrid[0:320, 0:240].astype(float)
    angle = math.radians(angle_deg)
    along = (x - 120) * math.cos(angle) - (y - 160) * math.sin(angle)
    across = (x - 120) * math.sin(angle) + (y - 160) * math.cos(angle)
    height = 8.0 / (1.0 + np.exp((np.hypot(np.maximum(np.abs(along) - 60, 0), across) - 18) / 3.0))
    down, right = np.gradient(height)
    lit = [right, 0.87 * down - 0.5 * right, -0.87 * down - 0.5 * right]
    frame = gel(320, 240, seed).astype(float) + 60.0 * np.stack(lit, axis=-1)
    return np.clip(frame, 0, 255).astype(np.uint8)


def require_possible(sample: SlipSample, frame: Image) -> None:
    """Fail if an estimate is invalid."""
    assert sample.fault is None
    assert 0.0 <= sample.contact_area_px <= frame.shape[0] * frame.shape[1]
    values = [sample.angle_deg, sample.sigma_deg, sample.rate_deg_s, *(sample.shift_px or ())]
    assert all(value is None or math.isfinite(value) for value in values)
    if sample.state is State.NO_CONTACT:
        assert sample.angle_deg is None
        assert sample.contact_area_px == 0.0


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_frame_of_any_size_gets_a_valid_estimate(
    make_estimator: MakeEstimator, size: tuple[int, int]
) -> None:
    estimator = make_estimator(gel(*size))
    for i, share in enumerate((0.0, 0.3, 0.6, 0.6, 1.0, 1.0, 0.0)):
        frame = touched(*size, share, i) if share else gel(*size, i + 1)
        sample = estimator.update(frame, i * STEP_NS)
        require_possible(sample, frame)
        assert sample.time_ns == i * STEP_NS


@pytest.mark.parametrize("image", REFUSED, ids=lambda image: f"{image.shape} {image.dtype}")
def test_invalid_frame_is_rejected(make_estimator: MakeEstimator, image: Image) -> None:
    with pytest.raises(InputError, match="tactile frame has"):
        make_estimator(image)
    estimator = make_estimator(gel(240, 320))
    with pytest.raises(InputError, match="tactile frame has"):
        estimator.update(image, 0)


def test_changed_frame_size_is_rejected_and_later_frames_are_estimated(make_estimator: MakeEstimator) -> None:
    estimator = make_estimator(gel(240, 320))
    estimator.update(gel(240, 320, 1), 0)
    with pytest.raises(InputError, match="use one size"):
        estimator.update(gel(120, 160), STEP_NS)
    frame = touched(240, 320, 0.5, 2)
    require_possible(estimator.update(frame, 2 * STEP_NS), frame)


def test_arm_state_is_accepted(make_estimator: MakeEstimator) -> None:
    estimator = make_estimator(gel(240, 320))
    pose = Pose.from_rotation((0.4, 0.0, 0.2), Rotation.identity())
    at_rest = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    estimator.arm(ArmState(0, pose, at_rest, at_rest, ArmMode.RUNNING))
    require_possible(estimator.update(gel(240, 320, 1), 0), gel(240, 320))


def test_same_frames_give_the_same_estimates(make_estimator: MakeEstimator) -> None:
    first, again = (answers(make_estimator(gel(320, 240))) for _ in range(2))
    assert [(s.state, s.angle_deg, s.sigma_deg) for s in first] == [
        (s.state, s.angle_deg, s.sigma_deg) for s in again
    ]


def test_rotation_is_positive_counter_clockwise(make_estimator: MakeEstimator) -> None:
    angles = [sample.angle_deg for sample in answers(make_estimator(gel(320, 240)))]
    before, after = angles[AT_REST - 1], angles[-1]
    if before is None or after is None:
        pytest.skip("the estimator refuses a bar drawn with simple lighting: its sign cannot be checked")
    turned = after - before
    assert LEAST_DEG < turned < MOST_DEG, f"the true rotation is {TURNING * STEP_DEG:g}: check sign and unit"


def answers(estimator: TactileEstimator) -> list[SlipSample]:
    """Return the estimates of a bar that is at rest and then rotates."""
    turns = [0.0] * AT_REST + [STEP_DEG * (i + 1) for i in range(TURNING)]
    frames = [pressed_bar(BAR_DEG + turn, seed) for seed, turn in enumerate(turns, 1)]
    return [estimator.update(frame, i * STEP_NS) for i, frame in enumerate(frames)]
