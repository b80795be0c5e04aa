"""Marker corners as intersections of lines fitted to the edges: the most accurate way, at some cost.

Each side is sampled across at many places. The centroid of the gradient gives the edge there, a line
is fitted to these points, and neighbouring lines are intersected. So a corner rests on all pixels of two
sides instead of the few around it.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import (
    Corners,
    Refusal,
    detect_all,
    detector,
    mean_side,
    refine_corners,
)
from drivers.types import Image

Array = NDArray[np.floating]

_NEXT, _BEFORE = np.array([1, 2, 3, 0]), np.array([3, 0, 1, 2])
_FROM_CORNER = 0.1
"""Share of a side at each end that is left out: the other edge blurs into it."""
_ACROSS_PX = 3.0
_STEPS = 13
_FEWEST = 4
_LEAST_CONTRAST = 12.0
_ROUNDS = 2
_ONE_ROUND_PX = 32.0
"""From here on one round from corners refined in windows is as good as two, at two thirds of the time."""


def find_corners(gray: Image, dictionary: str) -> dict[int, Corners]:
    """Search a whole (H, W) uint8 picture: (4, 2) px corners by edges of every id seen exactly once.

    dictionary: OpenCV's name, or the path of a dictionary file. Where a marker shows no clean edges
    its corners are as detected, good to about half a pixel. Raises `InputError`.
    """
    found = {}
    for marker_id, quads in detect_all(detector(dictionary), gray).items():
        if len(quads) == 1:
            fine = refine_edges(gray, quads[0][None])
            found[marker_id] = quads[0] if isinstance(fine, Refusal) else fine[0]
    return found


def refine_quick(gray: Image, corners: Corners) -> Corners | Refusal:
    """As `refine_edges`, for each picture of a stream: from corners refined in windows, where those are."""
    near = refine_corners(gray, corners)
    if isinstance(near, Refusal):
        return refine_edges(gray, corners)
    return refine_edges(gray, near, 1 if mean_side(near) >= _ONE_ROUND_PX else _ROUNDS)


def refine_edges(gray: Image, corners: Corners, rounds: int = _ROUNDS) -> Corners | Refusal:
    """Refine (M, 4, 2) px corners of dark markers on light paper by their edges.

    gray: (H, W) uint8. rounds: how often, each from the corners of the one before. Refused where a side
    shows fewer than four edge points, or where a corner would move by more than a fifth of the side.
    """
    side = mean_side(corners)
    reach = float(np.clip(0.09 * side, 1.6, _ACROSS_PX))
    found = corners
    for _ in range(rounds):
        lines = _edge_lines(gray, found, side, reach)
        if lines is None:
            return Refusal.NO_CORNER
        found = _intersections(*lines)
    moved = np.abs(found - corners).max()
    return found if moved <= max(0.2 * side, 2.0) else Refusal.NO_CORNER


class _Samples(NamedTuple):
    """Where sides are sampled: K places along each, S across.

    basis: (K S, 3) of the corner, the way along and the way outward. moments: (S - 1, 2) sum and first
    moment across. powers: (K, 3) of the share of the side, up to its square.
    """

    basis: Array
    moments: Array
    powers: Array


@lru_cache(maxsize=64)
def _samples(places: int, reach_tenths: int) -> _Samples:
    share = np.linspace(_FROM_CORNER, 1.0 - _FROM_CORNER, places)
    across = np.linspace(-reach_tenths / 10.0, reach_tenths / 10.0, _STEPS)
    along, outward = (grid.ravel() for grid in np.meshgrid(share, across, indexing="ij"))
    middle = (across[1:] + across[:-1]) / 2.0
    return _Samples(
        np.column_stack([np.ones_like(along), along, outward]),
        np.column_stack([np.ones_like(middle), middle]),
        np.vander(share, 3, increasing=True),
    )


def _edge_lines(gray: Image, corners: Corners, side: float, reach: float) -> tuple[Array, Array] | None:
    """A point on each side's line, (M, 4, 2), and its direction, (M, 4, 2); None where a side has no edge.

    Few calls on whole arrays: this runs on each picture of a stream.
    """
    ahead = corners.take(_NEXT, axis=1) - corners
    outward = ahead[..., ::-1] * (1.0, -1.0) / np.hypot(ahead[..., :1], ahead[..., 1:])
    samples = _samples(int(np.clip(side / 2.0, 8, 40)), round(10.0 * reach))
    where = samples.basis @ np.stack([corners, ahead, outward], axis=-2)
    values = cv2.remap(
        gray, where.reshape(-1, _STEPS, 2).astype(np.float32), None, cv2.INTER_LINEAR,  # type: ignore[call-overload]
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(*corners.shape[:2], -1, _STEPS).astype(np.float64)  # fmt: skip
    rise = np.maximum(values[..., 1:] - values[..., :-1], 0.0) @ samples.moments
    contrast = rise[..., 0]
    edge = rise[..., 1] / np.maximum(contrast, 1e-9)
    middle = contrast.size // 2
    usual = float(np.partition(contrast, middle, axis=None)[middle])  # the median, in a third of its time
    good = contrast > max(_LEAST_CONTRAST, 0.4 * usual)
    if (good.sum(axis=-1) < _FEWEST).any():
        return None
    start, slope = _fitted(edge, good.astype(np.float64), samples.powers)
    return corners + start[..., None] * outward, ahead + slope[..., None] * outward


def _fitted(edge: Array, weight: Array, powers: Array) -> tuple[Array, Array]:
    """Weighted straight lines through offsets (M, 4, K): offset at the corner, and its growth per side."""
    one, along, squared = np.moveaxis(weight @ powers, -1, 0)
    offset, turned = np.moveaxis((weight * edge) @ powers[:, :2], -1, 0)
    slope = (one * turned - along * offset) / (one * squared - along**2)
    return (offset - slope * along) / one, slope


def _intersections(point: Array, direction: Array) -> Corners:
    """(M, 4, 2): where each side's line meets the one before it."""
    before, course = point.take(_BEFORE, axis=1), direction.take(_BEFORE, axis=1)
    cross = course[..., 0] * direction[..., 1] - course[..., 1] * direction[..., 0]
    gap = point - before
    step = (gap[..., 0] * direction[..., 1] - gap[..., 1] * direction[..., 0]) / cross
    return before + step[..., None] * course
