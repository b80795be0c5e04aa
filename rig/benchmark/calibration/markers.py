"""Limits of the two-marker angle: accuracy end to end, time beside a full search, real markers found."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle
from calibration.targets.aruco import Refusal, detector
from calibration.targets.edges import find_corners
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.marker_pictures import MarkerPictures
from rig.benchmark.measured import Measured, at_least, at_most, informative, not_there

_FRAMES = 300
_AT_REST = 150
_BLOCK = 30


def marker_limits(seed: int, data: Path | None) -> list[Measured]:
    """640 x 480, 40 px markers, white noise of 4 grey, 15 degrees of tilt; turns of up to 30 degrees."""
    pictures = MarkerPictures(side_px=40.0, tilt_deg=15.0, noise_grey=4.0)
    rng = np.random.default_rng((seed, 10))
    camera = true_camera(pictures)
    angle = MarkerAngle(pictures.ids, pictures.dictionary, camera)
    angle.set_reference([pictures.draw(0.0, rng) for _ in range(30)])
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
        *_gold(data),
    ]


def true_camera(pictures: MarkerPictures) -> CameraModel:
    """The camera that the pictures were drawn with."""
    return CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)


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


def _gold(data: Path | None) -> list[Measured]:
    """Marker corners of OpenCV's photos; those of its own test are rounded and not refined."""
    names = ("real photos: marker ids not found", "real photos: worst distance from a gold corner, px")
    if data is None:
        return [not_there(name) for name in names]
    folder = data / "opencv_photos"
    gold = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    missing, worst = 0, 0.0
    for name in np.unique(gold["image"]):
        dictionary = str(folder / "tutorial_dict.yml") if name.startswith("gb") else "DICT_6X6_250"
        grey = read_image(folder / name, grey=True)
        found = find_corners(grey, dictionary)
        for row in gold[gold["image"] == name]:
            corners = np.array([[row[f"x{i}"], row[f"y{i}"]] for i in range(4)], np.float64)
            seen = found.get(int(row["marker_id"]))
            missing += seen is None
            if seen is not None:
                worst = max(worst, float(np.linalg.norm(seen - corners, axis=1).max()))
    return [at_most(names[0], missing, 0.0), at_most(names[1], worst, 2.0)]
