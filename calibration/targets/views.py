"""Views of a board, points of known place found in one picture, and checks of them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.verdict import Rejected, sift
from drivers.errors import counted

Array = NDArray[np.floating]

FEWEST_POINTS = 8
SAME_VIEW_PX = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One picture of a board.

    id: of the picture. ids: (N,) int64, point numbers of the board. board_m: (N, 3) float64, where
    they are on the board (z = 0), m. image_px: (N, 2) float64. size: width, height of the picture.
    """

    id: str
    ids: NDArray[np.int64]
    board_m: Array
    image_px: Array
    size: tuple[int, int]


def usable_views(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Leave out unusable views: not finite, too few points, collinear, of another size.

    The size of most views counts; a view shown before (all points within 2 px) is left out too:
    copies would look like evidence.
    """
    common = Counter(view.size for view in views).most_common(1)[0][0] if views else (0, 0)
    return sift(views, lambda view: view.id, lambda view, kept: _fault(view, common) or _repeats(view, kept))


def _fault(view: View, size: tuple[int, int]) -> str | None:
    if not (np.isfinite(view.image_px).all() and np.isfinite(view.board_m).all()):
        return "a corner is not a finite number"
    if len(view.ids) < FEWEST_POINTS:
        return f"{counted(len(view.ids), 'corner')} found, {FEWEST_POINTS} are needed"
    if view.size != size:
        return f"size {view.size[0]} x {view.size[1]} differs from the others' {size[0]} x {size[1]}"
    for points in (view.board_m[:, :2], view.image_px):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spread[1] < 0.02 * spread[0]:
            return "all corners lie on one line"
    return None


def _repeats(view: View, others: list[View]) -> str | None:
    for other in others:
        _, mine, its = np.intersect1d(view.ids, other.ids, return_indices=True)
        if len(mine) >= 4:
            moved = np.linalg.norm(view.image_px[mine] - other.image_px[its], axis=1)
            if moved.max() < SAME_VIEW_PX:
                return f"same view as {other.id}"
    return None


def coverage(views: Sequence[View], columns: int = 8, rows: int = 6) -> Array:
    """(rows, columns) counts of corners over the picture."""
    width, height = views[0].size
    points = np.vstack([view.image_px for view in views])
    counts, _, _ = np.histogram2d(
        points[:, 1], points[:, 0], bins=(rows, columns), range=((0, height), (0, width))
    )
    return counts
