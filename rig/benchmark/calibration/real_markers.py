"""Markers in real photographs: found, where they are known to be, and turned as they were printed."""

from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.tracker import Refine
from calibration.targets.aruco import Refusal, detect_all, detector, refine_corners
from calibration.targets.edges import find_corners, refine_quick
from drivers.images import read_image
from rig.benchmark.measured import Measured, at_most, informative, not_there

Array = NDArray[np.floating]

_FOUND = ("real photos: marker ids not found", "real photos: worst distance from a gold corner, px")
_TURNS = ("real photos: angle of two printed markers, rms, deg", "real photos: the same by corners, deg")
_BOARD = cv2.aruco.CharucoBoard((5, 7), 2.0, 1.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
"""Of OpenCV's four calibration photographs; squares are two markers wide, to which all of them agree."""
_FARTHEST_SIDES = 4.5


def real_marker_limits(data: Path | None) -> list[Measured]:
    """Limits on OpenCV's photographs, or rows that say that they are not there."""
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
    """How far pairs of markers of a printed board seem turned in its plane, where none is: rms, deg.

    The plane is that of the board's other markers; about 24 px wide markers, up to 4.5 sides apart.
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
    """As OpenCV calibrated it from the same photographs."""
    stored = cv2.FileStorage(str(folder / "tutorial_camera_charuco.yml"), cv2.FILE_STORAGE_READ)
    matrix = stored.getNode("camera_matrix").mat()
    lens = stored.getNode("distortion_coefficients").mat().ravel()
    return CameraModel((640, 480), np.asarray(matrix, np.float64), np.asarray(lens, np.float64))


def _gold(folder: Path) -> list[Measured]:
    """Marker corners of OpenCV's photos; those of its own test are rounded and not refined."""
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
