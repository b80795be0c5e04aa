"""`rig benchmark calibration`: the limits the calibrations have to keep, measured with fixed seeds."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.hand_eye.samples import Setup
from calibration.hand_eye.solve import calibrate_hand_eye
from calibration.time_offset import time_offset
from rig.benchmark.calibration import (
    degenerate_gel,
    degenerate_hand_eye,
    degenerate_images,
    degenerate_streams,
    degenerate_views,
)
from rig.benchmark.calibration.angle_scenes import AngleScore, angle_scores
from rig.benchmark.calibration.camera import camera_limits
from rig.benchmark.calibration.degenerate import CaseResult, run_cases
from rig.benchmark.calibration.gel import gel_limits
from rig.benchmark.calibration.hand_eye_scenes import CAMERA, general_scene
from rig.benchmark.calibration.markers import marker_limits
from rig.benchmark.calibration.motion_scenes import wiggle_scene
from rig.benchmark.measured import Measured, at_most, between, data_folder, informative

TRIALS = 200
_FLIPPED_TRIALS = 60
_SYNC_TRIALS = 40


@dataclass(frozen=True, slots=True)
class CalibrationReport:
    """What was measured, with its limits, what became of bad data, and the angle beside other ways."""

    rows: tuple[Measured, ...]
    cases: tuple[CaseResult, ...]
    angles: tuple[AngleScore, ...]

    @property
    def passed(self) -> bool:
        """Whether every limit holds and no bad data went through in silence."""
        return all(row.met is not False for row in self.rows) and not any(case.wrong for case in self.cases)


def run(say: Callable[[str], None], seed: int = 0, trials: int = TRIALS) -> CalibrationReport:
    """Measure everything; `say` is told what is being done. Takes some minutes on two cores."""
    cv2.setNumThreads(1)
    rows: list[Measured] = []
    data = data_folder()
    say("measuring: ways to the two-marker angle")
    scores = angle_scores(seed)
    for what, measure in (
        ("two-marker angle", lambda: marker_limits(seed, data, scores)),
        ("hand-eye", lambda: hand_eye_limits(seed, trials)),
        ("intrinsics", lambda: camera_limits(seed, data)),
        ("time offset", lambda: sync_limits(seed)),
        ("tactile map", lambda: gel_limits(data)),
    ):
        say(f"measuring: {what}")
        rows += measure()
    say("measuring: bad data")
    cases = [
        *degenerate_hand_eye.cases(),
        *degenerate_images.cases(),
        *degenerate_views.cases(),
        *degenerate_streams.cases(),
        *degenerate_gel.cases(),
    ]
    return CalibrationReport(tuple(rows), tuple(run_cases(cases, seed)), tuple(scores))


def hand_eye_limits(seed: int, trials: int) -> list[Measured]:
    """Twenty views of one 60 mm marker: 0.2 px, 0.1 mm, 0.02 degrees of noise; 0.5 to 0.9 m away."""
    errors, held = [], []
    for trial in range(trials):
        truth, samples = general_scene(np.random.default_rng((seed, 1, trial)))
        result = calibrate_hand_eye(samples, CAMERA, Setup.EYE_TO_HAND)
        if result.pose is None or result.spread is None:
            errors.append((np.inf, np.inf))
            held.append(False)
            continue
        errors.append(truth.error(result.pose))
        held.append(result.spread.holds(truth.error_vector(result.pose)))
    mm, deg = np.array(errors).T
    what = f"hand-eye, {trials} trials"
    return [
        at_most(f"{what}: median position, mm", np.median(mm), 0.5),
        at_most(f"{what}: 95 % position, mm", np.percentile(mm, 95), 1.0),
        at_most(f"{what}: median orientation, deg", np.median(deg), 0.05),
        at_most(f"{what}: 95 % orientation, deg", np.percentile(deg, 95), 0.1),
        between(f"{what}: 95 % region holds the truth", np.mean(held), 0.90, 0.98),
        *_flipped(seed),
        *_in_hand(seed),
    ]


def _flipped(seed: int) -> list[Measured]:
    worst = []
    for trial in range(_FLIPPED_TRIALS):
        truth, samples = general_scene(np.random.default_rng((seed, 2, trial)), flipped=2)
        result = calibrate_hand_eye(samples, CAMERA, Setup.EYE_TO_HAND)
        worst.append(np.inf if result.pose is None else truth.error(result.pose)[0])
    what = f"hand-eye, 2 of 20 flipped, {_FLIPPED_TRIALS} trials"
    return [
        at_most(f"{what}: 95 % position, mm", np.percentile(worst, 95), 1.0),
        informative(f"{what}: worst position, mm", np.max(worst)),
    ]


def _in_hand(seed: int) -> list[Measured]:
    off = []
    for trial in range(_FLIPPED_TRIALS):
        truth, samples = general_scene(np.random.default_rng((seed, 3, trial)), setup=Setup.EYE_IN_HAND)
        result = calibrate_hand_eye(samples, CAMERA, Setup.EYE_IN_HAND)
        off.append(np.inf if result.pose is None else truth.error(result.pose)[0])
    return [
        informative(f"eye-in-hand, same noise, {_FLIPPED_TRIALS} trials: median position, mm", np.median(off))
    ]


def sync_limits(seed: int) -> list[Measured]:
    """A camera at 30 Hz with 0.2 degrees of noise, 2 ms of jitter and 5 % drops against a robot at 500 Hz."""
    off = []
    for trial in range(_SYNC_TRIALS):
        found = time_offset(*wiggle_scene(np.random.default_rng((seed, 4, trial))))
        off.append(np.inf if found.offset_s is None else abs(found.offset_s - 0.0473))
    silent = 0
    for trial in range(_SYNC_TRIALS):
        found = time_offset(*wiggle_scene(np.random.default_rng((seed, 5, trial)), motion="static"))
        silent += found.offset_s is not None
    return [
        at_most(f"sync, {_SYNC_TRIALS} wiggles: 95 % error, ms", 1e3 * np.percentile(off, 95), 1.0),
        at_most(f"sync, {_SYNC_TRIALS} static recordings: answered", silent, 0.0),
    ]
