"""Targets as pictures, and as printable sheets with a bar to check the scale."""

import html
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import detector
from calibration.targets.boards import Charuco, Chessboard, Marker, parse_target
from drivers.errors import InputError
from drivers.types import Image

_PX_PER_MODULE = 24
_MARGIN_MM = 12.0
_BAR_MM = 100.0
TEXT_MM = 3.2
"""Size of the sheet's line of print."""
Rectangle = tuple[float, float, float, float]
"""x, y, width, height."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetPicture:
    """A target drawn on white paper.

    grey: (H, W) uint8. origin_m: (2,) target coordinates of the picture's top left corner.
    px_per_m: its density.
    """

    grey: Image
    origin_m: NDArray[np.floating]
    px_per_m: float


@lru_cache(maxsize=8)
def target_picture(spec: str) -> TargetPicture:
    """The picture of a target on white paper, as dense as printing or rendering needs."""
    shapes, size, margin = _rectangles(spec)
    density = _density(spec)
    high, wide = (int(np.ceil((s + 2 * margin) * density)) for s in (size[1], size[0]))
    fine = np.full((high, wide), 255, np.uint8)
    for x, y, w, h in shapes:
        left, top = round((x + margin) * density), round((y + margin) * density)
        fine[top : round((y + h + margin) * density), left : round((x + w + margin) * density)] = 0
    return TargetPicture(fine, _origin(spec) - margin, density)


@dataclass(frozen=True, slots=True)
class TargetSheet:
    """A sheet to print at 100 %, mm from its top left corner, y down.

    size_mm: width, height. ink: black rectangles (x, y, width, height): the target and a bar of
    100 mm with a tick every ten. text, text_mm: a line of print, and where its baseline begins.
    """

    size_mm: tuple[float, float]
    ink: tuple[Rectangle, ...]
    text: str
    text_mm: tuple[float, float]


def target_sheet(spec: str) -> TargetSheet:
    """Lay out a target's sheet with a bar to check with a ruler.

    Raises `InputError` for a target that is not understood.
    """
    shapes, size, _ = _rectangles(spec)
    foot = size[1] * 1e3 + 2 * _MARGIN_MM
    ink = [(_MARGIN_MM + x * 1e3, _MARGIN_MM + y * 1e3, w * 1e3, h * 1e3) for x, y, w, h in shapes]
    ticks = [(_MARGIN_MM + 10.0 * i - 0.1, foot, 0.2, 4.0) for i in range(11)]
    bar = (_MARGIN_MM, foot + 4.0, _BAR_MM, 0.4)
    wide = max(size[0] * 1e3, _BAR_MM) + 2 * _MARGIN_MM
    text = f"{spec} - print at 100 %; this bar must measure 100.0 mm; put the measured side into the name"
    return TargetSheet((wide, foot + 22.0), (*ink, bar, *ticks), text, (_MARGIN_MM, foot + 11.0))


def sheet_svg(spec: str) -> str:
    """The sheet as SVG. Raises `InputError` for a target that is not understood."""
    sheet = target_sheet(spec)
    (wide, high), (x, y) = sheet.size_mm, sheet.text_mm
    ink = "".join(
        f'<rect x="{left:.4f}" y="{top:.4f}" width="{w:.4f}" height="{h:.4f}"/>'
        for left, top, w, h in sheet.ink
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide:.3f}mm" height="{high:.3f}mm" '
        f'viewBox="0 0 {wide:.3f} {high:.3f}"><rect width="100%" height="100%" fill="#fff"/>'
        f'<g fill="#000" shape-rendering="crispEdges">{ink}'
        f'<text x="{x}" y="{y}" font-family="sans-serif" font-size="{TEXT_MM}">'
        f"{html.escape(sheet.text)}</text></g></svg>\n"
    )


def _rectangles(spec: str) -> tuple[list[Rectangle], tuple[float, float], float]:
    """Ink as rectangles (x, y, w, h) in m from the top left, the target's size, and its white margin."""
    target = parse_target(spec)
    if isinstance(target, Charuco):
        return _charuco_ink(target), _times(target.squares, target.square_m), target.square_m / 2
    if isinstance(target, Chessboard):
        squares = (target.corners[0] + 1, target.corners[1] + 1)
        return _checks(squares, target.square_m), _times(squares, target.square_m), target.square_m
    if isinstance(target, Marker):
        ink = _marker_ink(target.dictionary, target.marker_id, 0.0, 0.0, target.side_m)
        return ink, (target.side_m, target.side_m), target.side_m / 4
    raise InputError(f"target {spec}: there is no sheet for it")


def _charuco_ink(target: Charuco) -> list[Rectangle]:
    """Checks and markers where OpenCV's own board has them."""
    board = target.board()
    ink = _checks(target.squares, target.square_m, first_white=_first_white(target))
    for marker_id, corners in zip(
        np.asarray(board.getIds()).ravel(), np.asarray(board.getObjPoints()), strict=True
    ):
        x, y = corners[:, :2].min(axis=0)
        ink += _marker_ink(target.dictionary, int(marker_id), float(x), float(y), target.marker_m)
    return ink


def _first_white(target: Charuco) -> bool:
    """Whether the top left square holds a marker, which stands on white."""
    first = np.asarray(target.board().getObjPoints())[..., :2].min(axis=1)
    return bool((first.max(axis=1) < target.square_m).any())


def _checks(squares: tuple[int, int], side: float, first_white: bool = False) -> list[Rectangle]:
    return [
        (c * side, r * side, side, side)
        for r in range(squares[1])
        for c in range(squares[0])
        if (r + c) % 2 == int(first_white)
    ]


def _marker_ink(dictionary: str, marker_id: int, x: float, y: float, side: float) -> list[Rectangle]:
    words = detector(dictionary).getDictionary()
    if marker_id >= len(words.bytesList):
        raise InputError(f"marker {marker_id}: {dictionary} has ids 0 to {len(words.bytesList) - 1} only")
    modules = words.markerSize + 2
    cells = cv2.aruco.generateImageMarker(words, marker_id, modules)
    step = side / modules
    return [(x + c * step, y + r * step, step, step) for r, c in zip(*np.nonzero(cells == 0), strict=True)]


def _times(squares: tuple[int, int], side: float) -> tuple[float, float]:
    return squares[0] * side, squares[1] * side


def _origin(spec: str) -> NDArray[np.floating]:
    """Coordinates of the top left corner.

    A marker's origin is its middle, a chessboard's its first inner corner.
    """
    target = parse_target(spec)
    if isinstance(target, Marker):
        return np.full(2, -target.side_m / 2)
    return np.full(2, -target.square_m) if isinstance(target, Chessboard) else np.zeros(2)


def _density(spec: str) -> float:
    """Pixels per m at which every edge of the ink lies nearly on a whole pixel."""
    shapes, size, margin = _rectangles(spec)
    edges = np.unique(np.round(np.array([(x + margin, y + margin) for x, y, _, _ in shapes]).ravel(), 9))
    coarse = _PX_PER_MODULE / min(w for _, _, w, _ in shapes) / 2
    densities = np.clip(coarse, 1200 / max(size), 4000 / max(size)) * np.linspace(1.0, 2.0, 801)
    off = np.abs(densities[:, None] * edges - np.rint(densities[:, None] * edges)).max(axis=1)
    return float(densities[np.argmin(off)])
