"""Limits on the two-marker angle: end-to-end error, run time, and error on real photographs."""

import time
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle
from calibration.markers.tracker import MarkerTracker, Refine
from calibration.targets.aruco import (
    Corners,
    Refusal,
    detect_all,
    detector,
    refine_corners,
    refine_edges,
    refine_quick,
)
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.calibration.angle_scenes import true_camera
from rig.benchmark.measured import Measured, at_most, informative, not_there

_FRAMES = 300
_AT_REST = 150

Array = NDArray[np.floating]

_FOUND = ("real photos: marker ids not found", "real photos: worst distance from a gold corner, px")
_TURNS = ("real photos: angle of two printed markers, rms, deg", "real photos: the same by corners, deg")
_BOARD = cv2.aruco.CharucoBoard((5, 7), 2.0, 1.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
"""Board in OpenCV's four calibration photographs; the ratio of squares to markers, 2, fits all of them."""
_FARTHEST_SIDES = 4.5


def marker_limits(seed: int, data: Path | None) -> list[Measured]:
    """Measure on simulated images of 640 x 480 px.

    Markers of 40 px, white noise with a sigma of 4 grey levels, 15 degrees of tilt, rotations of up to 30
    degrees.
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
    return [
        at_most("angle, 40 px, noise 4, tilt 15: rms, deg", np.sqrt(np.mean(errors**2)), 0.03),
        at_most("angle, the same at rest: bias, deg", abs(np.mean(rest)), 0.01),
        at_most("angle: median per frame, ms of processor time", _median_ms(angle, frames[:150]), 0.6),
        *real_marker_limits(data),
    ]


def _median_ms(angle: MarkerAngle, frames: list[Image]) -> float:
    """Return the median processor time per frame, which does not include that of other programs."""
    spent_s = []
    for frame in frames:
        began = time.thread_time()
        angle.measure(frame)
        spent_s.append(time.thread_time() - began)
    return 1e3 * float(np.median(spent_s))


def _error(angle: MarkerAngle, picture: Image, truth_deg: float) -> float:
    seen = angle.measure(picture)
    return np.inf if isinstance(seen, Refusal) else seen.angle_deg - truth_deg


def real_marker_limits(data: Path | None) -> list[Measured]:
    """Return the limits on OpenCV's photographs, or rows without values if they are missing."""
    if data is None:
        return [not_there(name) for name in (*_FOUND, *_TURNS)]
    folder = data / "opencv_photos"
    ours, corners = (printed_turns(folder, refine) for refine in (refine_quick, refine_corners))
    return [
        *_gold(folder),
        at_most(_TURNS[0], ours, 0.2),
        informative(_TURNS[1], corners),
    ]


def printed_turns(folder: Path, refine: Refine) -> float:
    """Return the apparent rotation between pairs of parallel markers of a printed board: rms, deg.

    The plane is fitted to the board's other markers; markers are about 24 px wide, up to 4.5 sides apart.
    """
    camera = _camera(folder)
    found = [_board_markers(path, camera, refine) for path in sorted(folder.glob("charuco_img_*.jpg"))]
    turns = [turn for seen in found for turn in _turns(seen)]
    return float(np.sqrt(np.mean(np.square(turns))))


def _board_markers(path: Path, camera: CameraModel, refine: Refine) -> dict[int, Array]:
    grey = read_image(path, grey=True)
    seen = {}
    for marker_id, quads in detect_all(detector("DICT_6X6_250"), grey).items():
        fine = refine(grey, quads[0][None])
        if len(quads) == 1 and not isinstance(fine, Refusal):
            seen[marker_id] = camera.undistorted(fine)[0]
    return seen


def _turns(seen: dict[int, Array]) -> list[float]:
    printed = {
        int(i): np.asarray(corners)[:, :2]
        for i, corners in zip(np.ravel(_BOARD.getIds()), _BOARD.getObjPoints(), strict=True)
        if int(i) in seen
    }
    pairs = [
        pair
        for pair in combinations(sorted(printed), 2)
        if np.linalg.norm(printed[pair[0]].mean(axis=0) - printed[pair[1]].mean(axis=0)) < _FARTHEST_SIDES
    ]
    return [_turn(printed, seen, pair) for pair in pairs]


def _turn(printed: dict[int, Array], seen: dict[int, Array], pair: tuple[int, int]) -> float:
    others = [i for i in printed if i not in pair]
    plane_T_image, _ = cv2.findHomography(  # noqa: N806
        np.vstack([seen[i] for i in others]), np.vstack([printed[i] for i in others])
    )
    points = cv2.perspectiveTransform(np.vstack([seen[i] for i in pair])[None], plane_T_image)[0] @ (1, 1j)
    template = np.vstack([printed[i] for i in pair]) @ (1, 1j)
    turn = ((template - template.mean()).conj() * (points - points.mean())).sum()
    return float(np.degrees(np.angle(turn)))


def _camera(folder: Path) -> CameraModel:
    """Return the camera as OpenCV calibrated it from the same photographs."""
    stored = cv2.FileStorage(str(folder / "tutorial_camera_charuco.yml"), cv2.FILE_STORAGE_READ)
    matrix = stored.getNode("camera_matrix").mat()
    lens = stored.getNode("distortion_coefficients").mat().ravel()
    return CameraModel((640, 480), np.asarray(matrix, np.float64), np.asarray(lens, np.float64))


def find_corners(gray: Image, dictionary: str) -> dict[int, Corners]:
    """Return the corners, (4, 2) px, of each id that is detected exactly once in an (H, W) uint8 image.

    dictionary: OpenCV's name, or the path of a dictionary file. Corners are refined with the marker's edges.
    If the edges are not clean, the detected corners are returned, which are accurate to about half a pixel.
    Raises `InputError`.
    """
    found = {}
    for marker_id, quads in detect_all(detector(dictionary), gray).items():
        if len(quads) == 1:
            fine = refine_edges(gray, quads[0][None])
            found[marker_id] = quads[0] if isinstance(fine, Refusal) else fine[0]
    return found


def _gold(folder: Path) -> list[Measured]:
    """Compare with the marker corners in OpenCV's test data, which are rounded and not refined."""
    gold = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    missing, worst = 0, 0.0
    for name in np.unique(gold["image"]):
        dictionary = str(folder / "tutorial_dict.yml") if name.startswith("gb") else "DICT_6X6_250"
        found = find_corners(read_image(folder / name, grey=True), dictionary)
        for row in gold[gold["image"] == name]:
            corners = np.array([[row[f"x{i}"], row[f"y{i}"]] for i in range(4)], np.float64)
            seen = found.get(int(row["marker_id"]))
            missing += seen is None
            if seen is not None:
                worst = max(worst, float(np.linalg.norm(seen - corners, axis=1).max()))
    return [at_most(_FOUND[0], missing, 0.0), at_most(_FOUND[1], worst, 2.0)]
