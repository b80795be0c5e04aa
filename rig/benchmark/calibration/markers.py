"""Limits of the two-marker angle: accuracy end to end, time beside a full search, real markers found."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from calibration.markers.angle import MarkerAngle
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Refusal, detector
from drivers.types import Image
from fakes.studio.marker_pictures import MarkerPictures
from rig.benchmark.calibration.angle_scenes import AngleScore, true_camera
from rig.benchmark.calibration.real_markers import real_marker_limits
from rig.benchmark.measured import Measured, at_least, at_most, informative

_FRAMES = 300
_AT_REST = 150
_BLOCK = 30


def marker_limits(seed: int, data: Path | None, scores: Sequence[AngleScore]) -> list[Measured]:
    """640 x 480, 40 px markers, white noise of 4 grey, 15 degrees of tilt; turns of up to 30 degrees.

    scores: of `angle_scores`, where the rig's own way should be the best.
    """
    pictures = MarkerPictures(side_px=40.0, tilt_deg=15.0, noise_grey=4.0)
    rng = np.random.default_rng((seed, 10))
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), true_camera(pictures))
    angle.take_reference([pictures.draw(0.0, rng) for _ in range(30)])
    rest = [_error(angle, pictures.draw(0.0, rng), 0.0) for _ in range(_AT_REST)]
    turns = 30.0 * np.sin(np.arange(_FRAMES) / 25.0)
    moves = [(0.005 * float(np.sin(i / 20.0)), 0.0) for i in range(_FRAMES)]
    frames = [pictures.draw(float(t), rng, m) for t, m in zip(turns, moves, strict=True)]
    errors = np.array([_error(angle, f, float(t)) for f, t in zip(frames, turns, strict=True)])
    ours, full = _side_by_side(angle, pictures.dictionary, frames[:150])
    return [
        at_most("angle, 40 px, noise 4, tilt 15: rms, deg", np.sqrt(np.mean(errors**2)), 0.03),
        at_most("angle, the same at rest: bias, deg", abs(np.mean(rest)), 0.01),
        at_most("angle: median per frame, ms of processor time", 1e3 * ours, 0.6),
        at_least("angle: times faster than a full search, side by side", full / ours, 5.0),
        informative("full search: median per frame, ms of processor time", 1e3 * full),
        at_most("angle: rms over that of the better other way, worst scene", _worst_ratio(scores), 1.05),
        *real_marker_limits(data),
    ]


def _worst_ratio(scores: Sequence[AngleScore]) -> float:
    """Our rms error over the smaller one of the other ways, in the scene where that is largest."""
    ratios = []
    for scene in dict.fromkeys(score.scene for score in scores):
        *others, ours = (score.rms_deg for score in scores if score.scene == scene)
        ratios.append(ours / min(others))
    return max(ratios)


def _error(angle: MarkerAngle, picture: Image, truth_deg: float) -> float:
    seen = angle.measure(picture)
    return np.inf if isinstance(seen, Refusal) else seen.angle_deg - truth_deg


def _side_by_side(angle: MarkerAngle, dictionary: str, frames: list[Image]) -> tuple[float, float]:
    """Median s per frame of ours and of OpenCV's search of the whole picture.

    In turn over blocks of frames: both meet the same machine, and neither the other's caches in
    each frame, as neither would in use.
    """
    whole = detector(dictionary)
    angle.forget()
    angle.measure(frames[0])
    ours, full = [], []
    for start in range(0, len(frames), _BLOCK):
        block = frames[start : start + _BLOCK]
        ours += [_timed(lambda f=frame: angle.measure(f)) for frame in block]
        full += [_timed(lambda f=frame: whole.detectMarkers(f)) for frame in block]
    return float(np.median(ours)), float(np.median(full))


def _timed(work: Callable[[], object]) -> float:
    """Processor time, s: what else runs on the machine should not count."""
    began = time.thread_time()
    work()
    return time.thread_time() - began
