"""Limits of the hand-eye calibration and of the time offset between two devices."""

from collections.abc import Iterator

import numpy as np

from calibration.hand_eye.samples import Setup
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.time_offset import time_offset
from rig.benchmark.calibration.hand_eye_scenes import CAMERA, Truth, general_scene
from rig.benchmark.calibration.motion_scenes import wiggle_scene
from rig.benchmark.measured import Measured, at_most, between, informative

_FURTHER_TRIALS = 60
"""Trials with flipped views, and with the camera in the hand."""
_SYNC_TRIALS, _OFFSET_S = 40, 0.0473


def hand_eye_limits(seed: int, trials: int) -> list[Measured]:
    """Twenty views of one 60 mm marker: 0.2 px, 0.1 mm, 0.02 degrees of noise; 0.5 to 0.9 m away."""
    errors, held = [], []
    for truth, result in _trials((seed, 1), trials):
        if result.pose is None or result.spread is None:
            errors.append((np.inf, np.inf))
            held.append(False)
        else:
            errors.append(truth.error(result.pose))
            held.append(result.spread.holds(truth.error_vector(result.pose)))
    mm, deg = np.array(errors).T
    flipped = [_off_mm(*of) for of in _trials((seed, 2), _FURTHER_TRIALS, flipped=2)]
    in_hand = [_off_mm(*of) for of in _trials((seed, 3), _FURTHER_TRIALS, Setup.EYE_IN_HAND)]
    what = f"hand-eye, {trials} trials"
    few = f"hand-eye, 2 of 20 flipped, {_FURTHER_TRIALS} trials"
    hand = f"eye-in-hand, same noise, {_FURTHER_TRIALS} trials"
    return [
        at_most(f"{what}: median position, mm", np.median(mm), 0.5),
        at_most(f"{what}: 95 % position, mm", np.percentile(mm, 95), 1.0),
        at_most(f"{what}: median orientation, deg", np.median(deg), 0.05),
        at_most(f"{what}: 95 % orientation, deg", np.percentile(deg, 95), 0.1),
        between(f"{what}: 95 % region holds the truth", np.mean(held), 0.90, 0.98),
        at_most(f"{few}: 95 % position, mm", np.percentile(flipped, 95), 1.0),
        informative(f"{few}: worst position, mm", np.max(flipped)),
        informative(f"{hand}: median position, mm", np.median(in_hand)),
    ]


def _trials(
    seed: tuple[int, int], trials: int, setup: Setup = Setup.EYE_TO_HAND, flipped: int = 0
) -> Iterator[tuple[Truth, HandEyeResult]]:
    for trial in range(trials):
        truth, samples = general_scene(np.random.default_rng((*seed, trial)), setup=setup, flipped=flipped)
        yield truth, calibrate_hand_eye(samples, CAMERA, setup)


def _off_mm(truth: Truth, result: HandEyeResult) -> float:
    return np.inf if result.pose is None else truth.error(result.pose)[0]


def sync_limits(seed: int) -> list[Measured]:
    """A camera at 30 Hz with 0.2 degrees of noise, 2 ms of jitter and 5 % drops against a robot at 500 Hz."""

    def offsets(number: int, motion: str) -> list[float | None]:
        scenes = (
            wiggle_scene(np.random.default_rng((seed, number, trial)), motion, _OFFSET_S)
            for trial in range(_SYNC_TRIALS)
        )
        return [time_offset(*scene).offset_s for scene in scenes]

    off = [np.inf if found is None else abs(found - _OFFSET_S) for found in offsets(4, "chirp")]
    answered = sum(found is not None for found in offsets(5, "static"))
    return [
        at_most(f"sync, {_SYNC_TRIALS} wiggles: 95 % error, ms", 1e3 * np.percentile(off, 95), 1.0),
        at_most(f"sync, {_SYNC_TRIALS} static recordings: answered", answered, 0.0),
    ]
