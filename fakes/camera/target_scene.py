"""Render the simulated camera's image of a printed calibration target, a flat sheet on a grey bench."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image, Pose
from fakes.world.fixture import Sheet

_FINE = 2
"""Samples per pixel along each axis."""
_BENCH_GREY = 120
_BLUR_PX = 0.8
_NOISE_GREY = 1.5


def render_sheet(
    sheet: Sheet, camera_matrix: NDArray[np.float64], size: tuple[int, int], camera_T_target: Pose,  # noqa: N803
    rng: np.random.Generator,
) -> Image:  # fmt: skip
    """Return the image (H, W, 3) uint8 of a sheet in a pinhole camera. rng: draws the noise.

    A sheet whose back faces the camera, or whose origin is less than 5 cm in front of it, is not drawn.
    """
    width, height = size
    turn, place = camera_T_target.rotation.as_matrix(), np.asarray(camera_T_target.position_m)
    plane = np.column_stack([turn[:, :2], place])
    seen = np.full((height, width), np.float32(_BENCH_GREY))
    if place @ turn[:, 2] > 0.0 and place[2] > 0.05:
        wanted_px_per_m = _FINE * float(camera_matrix[0, 0]) / float(np.linalg.norm(place))
        # reduced to about twice the wanted density, so that sampling it does not alias
        coarse = _reduced(sheet, max(1, int(sheet.px_per_m / (2.0 * wanted_px_per_m))))
        scale, (x, y) = coarse.px_per_m, coarse.origin_m
        sheet_T_plane = np.array(  # noqa: N806 - frame names keep their case
            [[scale, 0.0, -x * scale - 0.5], [0.0, scale, -y * scale - 0.5], [0.0, 0.0, 1.0]]
        )
        # pixel centres are integers in the supersampled image too
        finer = np.array([[_FINE, 0, (_FINE - 1) / 2], [0, _FINE, (_FINE - 1) / 2], [0, 0, 1.0]])
        fine_T_sheet = finer @ camera_matrix @ plane @ np.linalg.inv(sheet_T_plane)  # noqa: N806
        fine = cv2.warpPerspective(
            coarse.grey, fine_T_sheet, (_FINE * width, _FINE * height), borderValue=_BENCH_GREY
        )
        seen = cv2.resize(fine.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(seen, (0, 0), _BLUR_PX)
    blurred += rng.standard_normal((height, width), np.float32) * np.float32(_NOISE_GREY)
    return np.repeat(np.clip(np.rint(blurred), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@lru_cache(maxsize=16)
def _reduced(sheet: Sheet, step: int) -> Sheet:
    rows, columns = (n // step * step for n in sheet.grey.shape)
    small = cv2.resize(
        sheet.grey[:rows, :columns], (columns // step, rows // step), interpolation=cv2.INTER_AREA
    )
    return Sheet(np.asarray(small, np.uint8), sheet.origin_m, sheet.px_per_m / step)
