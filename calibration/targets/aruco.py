"""Detect ArUco markers in a picture, and refine their corners in windows or by their edges.

OpenCV's own refinement limits its window to 0.3 of a module, so that it has no effect for small markers; the
window here scales with the marker. More accurate is refinement by edges: each side is sampled across at many
places, the centroid of the gradient gives the edge position there, a line is fitted to these positions, and
neighbouring lines are intersected. So a corner is determined by all pixels of two sides instead of a few
around it. OpenCV's CORNER_REFINE_APRILTAG takes 70 ms and more per picture for no better angle.
"""

from enum import StrEnum
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import CalibrationError, InputError
from drivers.types import Image

Corners = NDArray[np.float64]
"""(..., 4, 2) px: corners of markers, clockwise from each one's top left; pixel centres are integers."""

Array = NDArray[np.floating]

_NEXT, _BEFORE = np.array([1, 2, 3, 0]), np.array([3, 0, 1, 2])
"""Indices of the corners after and before each corner."""
_FROM_CORNER = 0.1
"""Fraction of a side at each end that is not sampled, because the other edge blurs into it."""
_ACROSS_PX = 3.0
"""Largest distance from a side at which it is sampled."""
_STEPS = 13
"""Samples across a side, on each line."""
_FEWEST = 4
"""Fewest edge points per side."""
_LEAST_CONTRAST = 12.0
"""Smallest contrast of an edge, grey levels."""
_ROUNDS = 2
"""Iterations of the edge refinement."""
_ONE_ROUND_PX = 32.0
"""Side from which one round, starting from window-refined corners, is as good as two, in 2/3 of the time."""
_SAME_PLACE = 0.3
"""Two quads closer than this fraction of the side are the same marker."""
_ONE_WINDOW = 23
"""Window of the adaptive threshold in small regions, px."""


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


def detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """Return a detector with three threshold windows and no refinement. Raises `InputError`."""
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), _parameters())


def region_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """Return a detector for small regions of a picture: one threshold window. Raises `InputError`."""
    parameters = _parameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = _ONE_WINDOW
    # a region contains little but the marker, so small outlines are its modules
    parameters.minMarkerPerimeterRate = 0.8
    # otherwise a marker would be grouped with the outline of its paper, cut by the region, and dropped
    parameters.minMarkerDistanceRate = 0.01
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), parameters)


def detect_all(aruco: cv2.aruco.ArucoDetector, gray: Image) -> dict[int, list[Corners]]:
    """Return the detected (4, 2) px quads of a (H, W) uint8 picture by id; double outlines count once."""
    quads, ids, _ = aruco.detectMarkers(gray)
    seen: dict[int, list[Corners]] = {}
    for marker_id, quad in zip([] if ids is None else ids.reshape(-1), quads, strict=True):
        others, found = seen.setdefault(int(marker_id), []), quad.reshape(4, 2).astype(np.float64)
        apart = _SAME_PLACE * mean_side(found)
        for i, other in enumerate(others):
            if np.linalg.norm(other.mean(axis=0) - found.mean(axis=0)) < apart:
                others[i] = max(other, found, key=mean_side)
                break
        else:
            others.append(found)
    return seen


def refine_corners(gray: Image, corners: Corners) -> Corners | Refusal:
    """Refine (M, 4, 2) px corners to sub-pixel accuracy; the window is 0.12 of the side, 3 to 9 px."""
    side = mean_side(corners)
    half = int(np.clip(round(0.12 * side), 3, 9))
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 0.005)
    refined = cv2.cornerSubPix(gray, start.copy(), (half, half), (-1, -1), stop)
    moved = np.abs(refined - start).max()
    if not moved <= half:
        return Refusal.NO_CORNER
    return refined.reshape(corners.shape).astype(np.float64)


def refine_quick(gray: Image, corners: Corners) -> Corners | Refusal:
    """Refine as `refine_edges`, but faster: from window-refined corners, if these are available."""
    near = refine_corners(gray, corners)
    if isinstance(near, Refusal):
        return refine_edges(gray, corners)
    return refine_edges(gray, near, 1 if mean_side(near) >= _ONE_ROUND_PX else _ROUNDS)


def refine_edges(gray: Image, corners: Corners, rounds: int = _ROUNDS) -> Corners | Refusal:
    """Refine (M, 4, 2) px corners of dark markers on light paper by their edges.

    gray: (H, W) uint8. rounds: number of iterations. Refused if a side shows fewer than four edge points, or
    if a corner would move by more than a fifth of the side.
    """
    side = mean_side(corners)
    reach = float(np.clip(0.09 * side, 1.6, _ACROSS_PX))
    found = corners
    for _ in range(rounds):
        lines = _edge_lines(gray, found, side, reach)
        if lines is None:
            return Refusal.NO_CORNER
        # the intersection of each side's line with the previous one
        point, direction = lines
        before, course = point.take(_BEFORE, axis=1), direction.take(_BEFORE, axis=1)
        cross = course[..., 0] * direction[..., 1] - course[..., 1] * direction[..., 0]
        gap = point - before
        step = (gap[..., 0] * direction[..., 1] - gap[..., 1] * direction[..., 0]) / cross
        found = before + step[..., None] * course
    moved = np.abs(found - corners).max()
    return found if moved <= max(0.2 * side, 2.0) else Refusal.NO_CORNER


def side_lengths(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    along = corners.take(_NEXT, axis=-2) - corners
    return np.hypot(along[..., 0], along[..., 1])  # takes a third of the time of np.linalg.norm


def mean_side(corners: NDArray[np.floating]) -> float:
    lengths = side_lengths(corners)
    return float(lengths.sum()) / lengths.size


def _parameters() -> cv2.aruco.DetectorParameters:
    """Return detector parameters: no refinement, and bits read from the middle third of a module.

    By default a bit is read from four by four samples in three quarters of its module, which fails for small
    or blurred markers (24 px, 15 degrees of tilt: 5 of 60 simulated pictures unread, with these parameters
    none; 40 px, blurred by 1.5 px: 11 and none).
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.33
    return parameters


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary of a name, or that of a file (nmarkers, markersize, marker_0 ...)."""
    if not name.endswith((".yml", ".yaml")):
        if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
            raise InputError(f"markers: OpenCV has no dictionary {name!r}; use a name such as DICT_4X4_50")
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    words = cv2.aruco.Dictionary()
    try:
        storage = cv2.FileStorage(name, cv2.FILE_STORAGE_READ)
        read = storage.isOpened() and words.readDictionary(storage.root())
    except cv2.error as error:
        raise CalibrationError(f"{name}: holds no marker dictionary OpenCV can read ({error.err})") from error
    if not read or len(words.bytesList) == 0:
        raise CalibrationError(
            f"{name}: no marker dictionary there; nmarkers, markersize, marker_0 are needed"
        )
    return words


@lru_cache(maxsize=64)
def _samples(places: int, reach_tenths: int) -> tuple[Array, Array, Array]:
    """Return basis, moments and powers of K places along a side, sampled at S places across it.

    basis: (K S, 3) coefficients of corner, direction along and direction outward. moments: (S - 1, 2) sum and
    first moment across. powers: (K, 3) powers 0 to 2 of the fraction of the side.
    """
    share = np.linspace(_FROM_CORNER, 1.0 - _FROM_CORNER, places)
    across = np.linspace(-reach_tenths / 10.0, reach_tenths / 10.0, _STEPS)
    along, outward = (grid.ravel() for grid in np.meshgrid(share, across, indexing="ij"))
    middle = (across[1:] + across[:-1]) / 2.0
    basis = np.column_stack([np.ones_like(along), along, outward])
    moments = np.column_stack([np.ones_like(middle), middle])
    return basis, moments, np.vander(share, 3, increasing=True)


def _edge_lines(gray: Image, corners: Corners, side: float, reach: float) -> tuple[Array, Array] | None:
    """Return a point on each side's line, (M, 4, 2), and its direction, (M, 4, 2); None without an edge.

    Few calls on whole arrays, because this runs on each picture of a stream.
    """
    ahead = corners.take(_NEXT, axis=1) - corners
    outward = ahead[..., ::-1] * (1.0, -1.0) / np.hypot(ahead[..., :1], ahead[..., 1:])
    basis, moments, powers = _samples(int(np.clip(side / 2.0, 8, 40)), round(10.0 * reach))
    where = basis @ np.stack([corners, ahead, outward], axis=-2)
    values = cv2.remap(
        gray, where.reshape(-1, _STEPS, 2).astype(np.float32), None, cv2.INTER_LINEAR,  # type: ignore[call-overload]
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(*corners.shape[:2], -1, _STEPS).astype(np.float64)  # fmt: skip
    rise = np.maximum(values[..., 1:] - values[..., :-1], 0.0) @ moments
    contrast = rise[..., 0]
    edge = rise[..., 1] / np.maximum(contrast, 1e-9)
    middle = contrast.size // 2
    usual = float(np.partition(contrast, middle, axis=None)[middle])  # the median, in a third of the time
    good = contrast > max(_LEAST_CONTRAST, 0.4 * usual)
    if (good.sum(axis=-1) < _FEWEST).any():
        return None
    # weighted straight lines: offset at the corner, and its slope per side
    weight = good.astype(np.float64)
    one, along, squared = np.moveaxis(weight @ powers, -1, 0)
    offset, turned = np.moveaxis((weight * edge) @ powers[:, :2], -1, 0)
    slope = (one * turned - along * offset) / (one * squared - along**2)
    start = (offset - slope * along) / one
    return corners + start[..., None] * outward, ahead + slope[..., None] * outward
