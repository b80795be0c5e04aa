"""Marker corners as intersections of lines fitted to the edges: the most accurate way, at some cost.

Each side is sampled across at many places. The centroid of the gradient gives the edge there, a line
is fitted to these points, and neighbouring lines are intersected. So a corner rests on all pixels of two
sides instead of the few around it.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import Corners, Refusal, detect_all, detector, side_lengths
from drivers.types import Image

Array = NDArray[np.floating]

_FROM_CORNER = 0.1
"""Share of a side at each end that is left out: the other edge blurs into it."""
_ACROSS_PX = 3.0
_STEPS = 13
_FEWEST = 4
_LEAST_CONTRAST = 12.0
_ROUNDS = 2


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


def refine_edges(gray: Image, corners: Corners) -> Corners | Refusal:
    """Refine (M, 4, 2) px corners of dark markers on light paper by their edges.

    gray: (H, W) uint8. Refused where a side shows fewer than four edge points, or where a corner
    would move by more than a fifth of the side.
    """
    side = float(side_lengths(corners).mean())
    reach = float(np.clip(0.09 * side, 1.6, _ACROSS_PX))
    found = corners
    for _ in range(_ROUNDS):
        lines = _edge_lines(gray, found, side, reach)
        if lines is None:
            return Refusal.NO_CORNER
        found = _intersections(*lines)
    moved = np.abs(found - corners).max()
    return found if moved <= max(0.2 * side, 2.0) else Refusal.NO_CORNER


def _edge_lines(gray: Image, corners: Corners, side: float, reach: float) -> tuple[Array, Array] | None:
    """A point on each side's line, (M, 4, 2), and its direction, (M, 4, 2); None where a side has no edge."""
    ahead = corners[:, [1, 2, 3, 0]] - corners
    along = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    share = np.linspace(_FROM_CORNER, 1.0 - _FROM_CORNER, int(np.clip(side / 2.0, 8, 40)))
    offsets = np.linspace(-reach, reach, _STEPS)
    starts = corners[:, :, None] + share[:, None] * ahead[:, :, None]
    where = starts[..., None, :] + offsets[:, None] * outward[:, :, None, None]
    values = cv2.remap(
        gray, where.reshape(-1, _STEPS, 2).astype(np.float32), None, cv2.INTER_LINEAR,  # type: ignore[call-overload]
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(where.shape[:-1]).astype(np.float64)  # fmt: skip
    rise = np.maximum(np.diff(values, axis=-1), 0.0)
    contrast = rise.sum(axis=-1)
    middle = (offsets[1:] + offsets[:-1]) / 2.0
    edge = (rise * middle).sum(axis=-1) / np.maximum(contrast, 1e-9)
    good = (contrast > _LEAST_CONTRAST) & (contrast > 0.4 * np.median(contrast))
    if (good.sum(axis=-1) < _FEWEST).any():
        return None
    return _fitted(share, edge, good.astype(np.float64), corners, ahead, outward)


def _fitted(
    share: Array, edge: Array, weight: Array, corners: Corners, ahead: Array, outward: Array
) -> tuple[Array, Array]:
    """Weighted straight lines through offsets (M, 4, K) across the sides, as point and direction."""
    total = weight.sum(axis=-1)
    mean_share = (weight * share).sum(axis=-1) / total
    mean_edge = (weight * edge).sum(axis=-1) / total
    from_mean = share - mean_share[..., None]
    spread = (weight * from_mean**2).sum(axis=-1)
    slope = (weight * from_mean * (edge - mean_edge[..., None])).sum(axis=-1) / spread
    point = corners + mean_share[..., None] * ahead + mean_edge[..., None] * outward
    return point, ahead + slope[..., None] * outward


def _intersections(point: Array, direction: Array) -> Corners:
    """(M, 4, 2): where each side's line meets the one before it."""
    before, course = point[:, [3, 0, 1, 2]], direction[:, [3, 0, 1, 2]]
    cross = course[..., 0] * direction[..., 1] - course[..., 1] * direction[..., 0]
    gap = point - before
    step = (gap[..., 0] * direction[..., 1] - gap[..., 1] * direction[..., 0]) / cross
    return before + step[..., None] * course
