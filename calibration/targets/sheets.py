"""Draw targets as pictures, and as printable sheets with a bar to check the scale."""

import html
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import detector
from calibration.targets.boards import Chessboard, Marker, parse_target
from drivers.errors import InputError
from drivers.types import Image

_PX_PER_MODULE = 24
"""Resolution of a drawn sheet: at least half this many px per narrowest rectangle."""
_MARGIN_MM = 12.0
"""Margin of the sheet."""
_BAR_MM = 100.0
"""Length of the printed scale bar."""
TEXT_MM = 3.2
"""Font size of the text on the sheet."""
Rectangle = tuple[float, float, float, float]
"""x, y, width, height."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetPicture:
    """A target drawn on white paper.

    grey: (H, W) uint8. origin_m: (2,) target coordinates of the picture's top left corner. px_per_m:
    resolution.
    """

    grey: Image
    origin_m: NDArray[np.floating]
    px_per_m: float


@lru_cache(maxsize=8)
def target_picture(spec: str) -> TargetPicture:
    """Draw a target on white paper, with a resolution sufficient for printing and rendering."""
    drawn = _draw(spec)
    margin, density = drawn.margin, drawn.density()
    high, wide = (int(np.ceil((s + 2 * margin) * density)) for s in (drawn.size[1], drawn.size[0]))
    fine = np.full((high, wide), 255, np.uint8)
    for x, y, w, h in drawn.ink:
        left, top = round((x + margin) * density), round((y + margin) * density)
        fine[top : round((y + h + margin) * density), left : round((x + w + margin) * density)] = 0
    return TargetPicture(fine, np.full(2, drawn.corner) - margin, density)


@dataclass(frozen=True, slots=True)
class TargetSheet:
    """A sheet to print at 100 %, mm from its top left corner, y down.

    size_mm: width, height. ink: black rectangles (x, y, width, height): the target, and a bar of 100 mm with
    a tick every 10 mm. text, text_mm: a line of text, and the start of its baseline.
    """

    size_mm: tuple[float, float]
    ink: tuple[Rectangle, ...]
    text: str
    text_mm: tuple[float, float]


def target_sheet(spec: str) -> TargetSheet:
    """Lay out a target's sheet, with a bar to measure with a ruler.

    Raises `InputError` for an invalid target.
    """
    drawn = _draw(spec)
    size = drawn.size
    foot = size[1] * 1e3 + 2 * _MARGIN_MM
    ink = [(_MARGIN_MM + x * 1e3, _MARGIN_MM + y * 1e3, w * 1e3, h * 1e3) for x, y, w, h in drawn.ink]
    ticks = [(_MARGIN_MM + 10.0 * i - 0.1, foot, 0.2, 4.0) for i in range(11)]
    bar = (_MARGIN_MM, foot + 4.0, _BAR_MM, 0.4)
    wide = max(size[0] * 1e3, _BAR_MM) + 2 * _MARGIN_MM
    text = f"{spec} - print at 100 %; this bar must measure 100.0 mm; put the measured side into the name"
    return TargetSheet((wide, foot + 22.0), (*ink, bar, *ticks), text, (_MARGIN_MM, foot + 11.0))


def sheet_svg(spec: str) -> str:
    """Return the sheet as SVG. Raises `InputError` for an invalid target."""
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


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A target's ink as rectangles from its top left corner, its size and its white margin, in m.

    corner: x and y of the top left corner in the target's coordinates. A marker's origin is its middle, a
    chessboard's its first inner corner.
    """

    ink: list[Rectangle]
    size: tuple[float, float]
    margin: float
    corner: float = 0.0

    def density(self) -> float:
        """Return the resolution in px per m at which every edge of the ink is nearly on a whole pixel."""
        corners = [(x + self.margin, y + self.margin) for x, y, _, _ in self.ink]
        edges = np.unique(np.round(np.array(corners).ravel(), 9))
        coarse = _PX_PER_MODULE / min(w for _, _, w, _ in self.ink) / 2
        longest = max(self.size)
        densities = np.clip(coarse, 1200 / longest, 4000 / longest) * np.linspace(1.0, 2.0, 801)
        off = np.abs(densities[:, None] * edges - np.rint(densities[:, None] * edges)).max(axis=1)
        return float(densities[np.argmin(off)])


def _draw(spec: str) -> _Drawn:
    target = parse_target(spec)
    if isinstance(target, Marker):
        side = target.side_m
        ink = _marker_ink(target.dictionary, target.marker_id, 0.0, 0.0, side)
        return _Drawn(ink, (side, side), side / 4, -side / 2)
    side = target.square_m
    if isinstance(target, Chessboard):
        across, down = target.corners[0] + 1, target.corners[1] + 1
        return _Drawn(_checks(across, down, side), (across * side, down * side), side, -side)
    # squares and markers at the positions of OpenCV's own board; a marker is on a white square
    board, (across, down) = target.board(), target.squares
    starts = np.asarray(board.getObjPoints())[..., :2].min(axis=1)
    ink = _checks(across, down, side, int((starts.max(axis=1) < side).any()))
    for marker_id, (x, y) in zip(np.asarray(board.getIds()).ravel(), starts, strict=True):
        ink += _marker_ink(target.dictionary, int(marker_id), float(x), float(y), target.marker_m)
    return _Drawn(ink, (across * side, down * side), side / 2)


def _checks(across: int, down: int, side: float, first: int = 0) -> list[Rectangle]:
    """Return every other square as ink. first: 0 if the top left one is black."""
    squares = ((c, r) for r in range(down) for c in range(across) if (r + c) % 2 == first)
    return [(c * side, r * side, side, side) for c, r in squares]


def _marker_ink(dictionary: str, marker_id: int, x: float, y: float, side: float) -> list[Rectangle]:
    words = detector(dictionary).getDictionary()
    if marker_id >= len(words.bytesList):
        raise InputError(f"marker {marker_id}: {dictionary} has ids 0 to {len(words.bytesList) - 1} only")
    modules = words.markerSize + 2
    cells = cv2.aruco.generateImageMarker(words, marker_id, modules)
    step = side / modules
    return [(x + c * step, y + r * step, step, step) for r, c in zip(*np.nonzero(cells == 0), strict=True)]
