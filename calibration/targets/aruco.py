"""ArUco markers of one picture: detected, and their corners refined.

OpenCV's own refinement caps its window at 0.3 of a module and then does nothing for small
markers, so corners are refined here with a window that follows the marker's size.
"""

from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import CalibrationError, InputError
from drivers.types import Image

Corners = NDArray[np.float64]
"""(..., 4, 2) px: markers' corners, clockwise from each one's top left; pixel centres at whole numbers."""

_NEXT = np.array([1, 2, 3, 0])
_SAME_PLACE = 0.3
_ONE_WINDOW = 23


class Refusal(StrEnum):
    """Why a picture gives no corners or no angle."""

    NOT_FOUND = "no marker found"
    ONE_HIDDEN = "one marker not found"
    DUPLICATE = "marker id seen twice"
    JUMP = "implausible jump"
    TOO_SMALL = "marker too small"
    UNEQUAL = "markers differ in size"
    NO_CORNER = "corner without an edge"
    OUT_OF_PLANE = "moved out of its plane"
    OLD_TIME = "time not later than the last"


def detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """A detector with three threshold windows and no refinement. Raises `InputError`."""
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), _parameters())


def region_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """A detector for small regions of a picture: one threshold window. Raises `InputError`."""
    parameters = _parameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = _ONE_WINDOW
    # a region holds little but the marker, so small outlines are its modules
    parameters.minMarkerPerimeterRate = 0.8
    # grouped with the outline of its own paper, cut by the region, a marker would be dropped
    parameters.minMarkerDistanceRate = 0.01
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), parameters)


def detect_all(aruco: cv2.aruco.ArucoDetector, gray: Image) -> dict[int, list[Corners]]:
    """Detected (4, 2) px quads of a (H, W) uint8 picture by id; one outlined twice counts once."""
    quads, ids, _ = aruco.detectMarkers(gray)
    seen: dict[int, list[Corners]] = {}
    for marker_id, quad in zip([] if ids is None else ids.reshape(-1), quads, strict=True):
        others = seen.setdefault(int(marker_id), [])
        _add_apart(others, quad.reshape(4, 2).astype(np.float64))
    return seen


def refine_corners(gray: Image, corners: Corners) -> Corners | Refusal:
    """Refine (M, 4, 2) px corners to sub-pixel, the window 0.12 of the side, 3 to 9 px."""
    side = mean_side(corners)
    half = int(np.clip(round(0.12 * side), 3, 9))
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 0.005)
    refined = cv2.cornerSubPix(gray, start.copy(), (half, half), (-1, -1), stop)
    moved = np.abs(refined - start).max()
    if not moved <= half:
        return Refusal.NO_CORNER
    return refined.reshape(corners.shape).astype(np.float64)


def side_lengths(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    """Lengths of the sides, (..., 4), of (..., 4, 2) corners."""
    along = corners.take(_NEXT, axis=-2) - corners
    return np.hypot(along[..., 0], along[..., 1])  # a third of the time of np.linalg.norm


def mean_side(corners: NDArray[np.floating]) -> float:
    """Mean length of the sides of (..., 4, 2) corners."""
    lengths = side_lengths(corners)
    return float(lengths.sum()) / lengths.size


def _parameters() -> cv2.aruco.DetectorParameters:
    """No refinement, and bits read from the middle third of a module.

    By default a bit is read from four by four samples of three quarters of its module; a small
    or blurred marker then goes unread (24 px, 15 degrees of tilt: 5 of 60 simulated pictures,
    and none so; 40 px, blurred by 1.5 px: 11 and none).
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.33
    return parameters


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    if name.endswith((".yml", ".yaml")):
        return _dictionary_file(name)
    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise InputError(f"markers: OpenCV has no dictionary {name!r}; use a name such as DICT_4X4_50")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _dictionary_file(path: str) -> cv2.aruco.Dictionary:
    """A dictionary of one's own in OpenCV's format (nmarkers, markersize, marker_0 ...)."""
    words = cv2.aruco.Dictionary()
    try:
        storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
        read = storage.isOpened() and words.readDictionary(storage.root())
    except cv2.error as error:
        raise CalibrationError(f"{path}: holds no marker dictionary OpenCV can read ({error.err})") from error
    if not read or len(words.bytesList) == 0:
        raise CalibrationError(
            f"{path}: no marker dictionary there; nmarkers, markersize, marker_0 are needed"
        )
    return words


def _add_apart(others: list[Corners], quad: Corners) -> None:
    for i, other in enumerate(others):
        if np.linalg.norm(other.mean(axis=0) - quad.mean(axis=0)) < _SAME_PLACE * side_lengths(quad).mean():
            others[i] = max(other, quad, key=lambda q: side_lengths(q).mean())
            return
    others.append(quad)
