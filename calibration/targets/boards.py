"""Calibration targets: ChArUco boards, chessboards and single markers; detection of their points in pictures.

A target is identified by a short text, which `rig calibrate board` also prints on the sheet:

    charuco:7x5:25:18:DICT_5X5_100[:legacy]   squares across x down, square and marker side in mm
    chessboard:9x6:25[:11]                    inner corners across x down, square side in mm, window in px
    marker:60:DICT_4X4_50:0                   side in mm, dictionary, id
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import Refusal, detect_all, detector, refine_edges
from calibration.verdict import Rejected, sift
from drivers.errors import InputError, plural
from drivers.types import Image

Array = NDArray[np.floating]

FEWEST_POINTS = 8
"""Fewest corners of a usable view."""
SAME_VIEW_PX = 2.0
"""A view whose corners (or a press whose circle) all moved by less than this repeats another one."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One picture of a board.

    id: of the picture. ids: (N,) int64, point numbers on the board. board_m: (N, 3) float64, their positions
    on the board (z = 0), m. image_px: (N, 2) float64. size: width, height of the picture in px.
    """

    id: str
    ids: NDArray[np.int64]
    board_m: Array
    image_px: Array
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Charuco:
    """A ChArUco board. legacy: OpenCV's pattern before 4.6, which differs for even rows."""

    squares: tuple[int, int]
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False

    @property
    def spec(self) -> str:
        across, down = self.squares
        sides = f"{self.square_m * 1e3:g}:{self.marker_m * 1e3:g}"
        return f"charuco:{across}x{down}:{sides}:{self.dictionary}{':legacy' * self.legacy}"

    def board(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's board. Raises `InputError` for an unknown or too small dictionary."""
        words = detector(self.dictionary).getDictionary()
        if self.squares[0] * self.squares[1] // 2 > len(words.bytesList):
            raise InputError(f"board {self.spec}: {self.dictionary} has too few markers for it")
        board = cv2.aruco.CharucoBoard(self.squares, self.square_m, self.marker_m, words)
        board.setLegacyPattern(self.legacy)
        return board

    def find(self, gray: Image, view_id: str) -> View | str:
        """Find its chessboard corners; part of the board is sufficient."""
        check_gray(gray, view_id)
        board = self.board()
        corners, ids, _, marker_ids = cv2.aruco.CharucoDetector(board).detectBoard(gray)
        if ids is None or corners is None or len(ids) == 0:
            seen = 0 if marker_ids is None else len(marker_ids)
            hint = "; is its pattern legacy, or its dictionary wrong?" if seen else ""
            return f"no ChArUco corner found ({seen} of its markers seen{hint})"
        flat = ids.reshape(-1).astype(np.int64)
        places = np.asarray(board.getChessboardCorners(), np.float64)[flat]
        return View(view_id, flat, places, corners.reshape(-1, 2).astype(np.float64), gray.shape[::-1])


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A plain chessboard, counted in inner corners; all of it must be visible.

    window_px: half size of the window in which a corner is refined. Default: 0.35 of the distance of the
    closest two corners, 3 to 11 px, so that no window contains a neighbour. (OpenCV's sample always takes 11;
    on its own photos that doubles the error of held-out views, 0.42 px instead of 0.18.)
    """

    corners: tuple[int, int]
    square_m: float
    window_px: int | None = None

    @property
    def spec(self) -> str:
        window = f":{self.window_px}" if self.window_px else ""
        return f"chessboard:{self.corners[0]}x{self.corners[1]}:{self.square_m * 1e3:g}{window}"

    @property
    def places_m(self) -> Array:
        """(N, 3) positions of the corners on the board, row by row."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square_m

    def find(self, gray: Image, view_id: str) -> View | str:
        """Find all its inner corners."""
        check_gray(gray, view_id)
        found, seen = cv2.findChessboardCorners(gray, self.corners)
        if not found:
            return f"no chessboard of {self.corners[0]} x {self.corners[1]} inner corners found"
        grid = seen.reshape(self.corners[1], self.corners[0], 2)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
        half = self.window_px or int(np.clip(0.35 * min(steps), 3, 11))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)
        fine = cv2.cornerSubPix(gray, seen, (half, half), (-1, -1), stop).reshape(-1, 2)
        return View(view_id, np.arange(len(fine)), self.places_m, fine.astype(np.float64), gray.shape[::-1])


@dataclass(frozen=True, slots=True)
class Marker:
    """One square marker; its corners clockwise from its own top left, x right, y down, z away."""

    side_m: float
    dictionary: str
    marker_id: int

    @property
    def spec(self) -> str:
        return f"marker:{self.side_m * 1e3:g}:{self.dictionary}:{self.marker_id}"

    @property
    def places_m(self) -> Array:
        """(4, 3) positions of the corners; the origin is in the middle."""
        half = self.side_m / 2
        return np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])

    def find(self, gray: Image, view_id: str) -> View | str:
        """Find it, its corners refined by edges (windows would bias them). Rejected if found twice."""
        check_gray(gray, view_id)
        quads = detect_all(detector(self.dictionary), gray).get(self.marker_id, [])
        if len(quads) != 1:
            return str(Refusal.DUPLICATE if quads else Refusal.NOT_FOUND) + f" (id {self.marker_id})"
        fine = refine_edges(gray, quads[0][None])
        if isinstance(fine, Refusal):
            return str(fine)
        return View(view_id, np.arange(4), self.places_m, fine[0], gray.shape[::-1])


Target = Charuco | Chessboard | Marker
"""A flat target with points that can be detected in a picture."""


def parse_target(spec: str) -> Target:
    """Parse a target's text. Raises `InputError` with the valid forms."""
    kind, *parts = spec.strip().split(":")
    try:
        if kind == "charuco" and len(parts) in (4, 5):
            square, marker = _mm(parts[1]), _mm(parts[2])
            if not marker < square or parts[4:] not in ([], ["legacy"]):
                raise ValueError
            return Charuco(_pair(parts[0], 3), square, marker, parts[3], bool(parts[4:]))
        if kind == "chessboard" and len(parts) in (2, 3):
            window = int(parts[2]) if parts[2:] else None
            if window is not None and not 2 <= window <= 50:
                raise ValueError
            return Chessboard(_pair(parts[0], 3), _mm(parts[1]), window)
        if kind == "marker" and len(parts) == 3 and int(parts[2]) >= 0:
            return Marker(_mm(parts[0]), parts[1], int(parts[2]))
    except ValueError:
        pass
    raise InputError(
        f"target '{spec}': not valid; use charuco:7x5:25:18:DICT_5X5_100[:legacy], "
        "chessboard:9x6:25[:11] or marker:60:DICT_4X4_50:0 (sides in mm)"
    )


def check_gray(gray: Image, name: str) -> None:
    """Raise `InputError` unless a picture is (H, W) uint8 and not empty."""
    if gray.ndim != 2 or gray.dtype != np.uint8 or gray.size == 0:
        raise InputError(f"{name}: a (H, W) uint8 picture is needed, got {gray.shape} {gray.dtype}")


def _pair(text: str, least: int) -> tuple[int, int]:
    across, down = (int(part) for part in text.split("x"))
    if not (least <= across <= 60 and least <= down <= 60):
        raise ValueError
    return across, down


def _mm(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 2000.0:
        raise ValueError
    return value / 1e3


def usable_views(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Reject unusable views: not finite, too few points, collinear, or of another size.

    The most frequent size is required. A repeated view (all points within 2 px) is rejected too, because
    copies would count as independent measurements.
    """
    common = Counter(view.size for view in views).most_common(1)[0][0] if views else (0, 0)

    def fault(view: View, kept: list[View]) -> str | None:
        (width, height), (wide, high) = view.size, common
        resized = f"size {width} x {height} differs from the others' {wide} x {high}"
        few = f"{plural(len(view.ids), 'corner')} found, at least {FEWEST_POINTS} are needed"
        reason = view_fault(view, FEWEST_POINTS, few, common, resized)
        if reason is None and (on_one_line(view.board_m[:, :2]) or on_one_line(view.image_px)):
            reason = "all corners lie on one line"
        return reason or _repeats(view, kept)

    return sift(views, lambda view: view.id, fault)


def view_fault(view: View, fewest: int, few: str, size: tuple[int, int], resized: str) -> str | None:
    """Return why a view cannot be used, or None: not finite, fewer points, or a picture of another size.

    few, resized: the reasons for fewer points than `fewest`, and for another size than `size`.
    """
    if not (np.isfinite(view.image_px).all() and np.isfinite(view.board_m).all()):
        return "a corner is NaN or infinite"
    if len(view.ids) < fewest:
        return few
    return resized if view.size != size else None


def on_one_line(points: Array) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 0.02 * spread[0])


def outside(view: View) -> str | None:
    """Return that points lie outside the picture of the stated size, or None.

    A centre of a pixel is an integer, so the picture ends half a pixel beyond the first and the last one. A
    corner that is refined at the border may lie half a pixel further out.
    """
    beyond = (view.image_px < -1.0).any(axis=1) | (view.image_px > view.size).any(axis=1)
    if not beyond.any():
        return None
    x, y = view.image_px[beyond][0]
    width, height = view.size
    return (
        f"{plural(int(beyond.sum()), 'point')} outside the picture of {width} x {height} px, as at "
        f"({x:.0f}, {y:.0f})"
    )


def _repeats(view: View, others: list[View]) -> str | None:
    for other in others:
        _, mine, its = np.intersect1d(view.ids, other.ids, return_indices=True)
        if len(mine) >= 4:
            moved = np.linalg.norm(view.image_px[mine] - other.image_px[its], axis=1)
            if moved.max() < SAME_VIEW_PX:
                return f"same view as {other.id}"
    return None


def coverage(views: Sequence[View], columns: int = 8, rows: int = 6) -> Array:
    """Return counts of corners over the picture, (rows, columns)."""
    width, height = views[0].size
    points = np.vstack([view.image_px for view in views])
    counts, _, _ = np.histogram2d(
        points[:, 1], points[:, 0], bins=(rows, columns), range=((0, height), (0, width))
    )
    return counts
