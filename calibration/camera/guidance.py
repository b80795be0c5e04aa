"""Choose the views of a board that determine a camera best, before any is taken."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from drivers.types import Pose

Array = NDArray[np.floating]

_BORDER_PX = 8.0
"""Corners nearer to the border count as outside the picture."""
_LEAST_FACING = 0.6
"""Cosine of the largest angle at which a board is still detected reliably."""
_INTRINSIC = 6
"""Number of estimated terms: focal lengths, principal point, two radial terms."""
_CELLS, _NEW_CELL = (8, 6), 0.1
"""Grid cells of the picture, and the gain of a cell without a view so far, in units of log information."""
Cells = frozenset[tuple[int, int]]


def most_telling(
    camera: CameraModel,
    points_m: Array,
    camera_T_board: Sequence[Pose],  # noqa: N803 - frame names keep their case
    count: int,
) -> list[int]:
    """Choose views, by index, that together determine the camera best; the most informative first.

    points_m: (N, 3) of the board. Views that do not show all of it, well inside the picture and not too
    oblique, are not chosen. Each view's own pose is treated as unknown. A view in an area without views so
    far counts more, because the lens is extrapolated outside the observed area.
    """
    known_views = {i: _information(camera, points_m, pose) for i, pose in enumerate(camera_T_board)}
    left = {i: known for i, known in known_views.items() if known is not None}
    whole, covered, chosen = 1e-6 * np.eye(_INTRINSIC), Cells(), []
    while left and len(chosen) < count:
        worth = {
            i: np.linalg.slogdet(whole + information)[1] + _NEW_CELL * len(cells - covered)
            for i, (information, cells) in left.items()
        }
        best = max(worth, key=lambda i: worth[i])
        information, cells = left.pop(best)
        whole, covered = whole + information, covered | cells
        chosen.append(best)
    return chosen


def _information(camera: CameraModel, points_m: Array, pose: Pose) -> tuple[Array, Cells] | None:
    """Return the information (6, 6) on the camera's terms, pose eliminated, and the view's grid cells.

    None if the board is not seen well.
    """
    in_camera = pose.rotation.apply(points_m) + np.asarray(pose.position_m)
    sight = in_camera.mean(axis=0)
    facing = float(pose.rotation.as_matrix()[:, 2] @ sight) / float(np.linalg.norm(sight))
    if in_camera[:, 2].min() <= 0.05 or abs(facing) < _LEAST_FACING:
        return None
    pixels, jacobian = cv2.projectPoints(
        np.asarray(points_m, float), pose.rotation.as_rotvec(), np.asarray(pose.position_m, float),
        np.asarray(camera.matrix, float), np.zeros(5),
    )  # fmt: skip
    inside = (pixels > _BORDER_PX) & (pixels < np.subtract(camera.size, 1 + _BORDER_PX))
    if not inside.all():
        return None
    view, own = jacobian[:, :6], jacobian[:, 6 : 6 + _INTRINSIC].copy()
    own[:, :2] *= camera.matrix[0, 0]
    own[:, 2:4] *= camera.size[0]
    across = own.T @ view
    cells = np.floor(pixels.reshape(-1, 2) / camera.size * _CELLS).astype(int)
    information = own.T @ own - across @ np.linalg.pinv(view.T @ view) @ across.T
    return np.asarray(information), frozenset(map(tuple, cells.tolist()))
