"""How well the colours of a unit show slopes of each direction, compared with the noise of its frames.

The three LEDs stand on different sides, so that a slope in any direction changes a colour. Where the light
of two LEDs comes from opposite sides and the third is weak, slopes in one direction change hardly anything.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.gel.look import HALF, SLOPE_TERMS, GelLook

_SLOPE = 0.1
"""Slope (mm/mm) of a broad contact, as of a bottle in the fingers."""
_STEP_PX = 20


@dataclass(frozen=True, slots=True)
class Visibility:
    """Colour change by a slope of 0.1 in the direction that shows least, in sigma of the noise.

    median: over the gel. worst: of the place at worst_px (x, y).
    """

    median: float
    worst: float
    worst_px: tuple[float, float]


def visibility(look: GelLook) -> Visibility:
    """Measure how well a unit shows slopes, on a grid of places."""
    grid = slice(_STEP_PX // 2, None, _STEP_PX)
    response = change_by_slope(look, _SLOPE)[grid, grid]
    whitened = np.linalg.solve(np.linalg.cholesky(look.noise.colours), response)
    least = np.linalg.svd(whitened, compute_uv=False)[..., 1]
    row, column = np.unravel_index(int(least.argmin()), least.shape)
    at = ((int(column) + 0.5) * _STEP_PX * HALF, (int(row) + 0.5) * _STEP_PX * HALF)
    return Visibility(float(np.median(least)), float(least.min()), at)


def change_by_slope(look: GelLook, slope: float) -> NDArray[np.float32]:
    """Colour change (h, w, 3, 2), grey levels, by a slope (mm/mm) along x and along y, without shadows."""
    slopes = replace(look, shadows=False, weights=look.weights[: SLOPE_TERMS * len(look.places)])
    rows, columns = (size // HALF for size in look.shape)
    across, along = (HALF * slope * mm for mm in look.mm_per_px)
    ramps = (
        np.arange(columns) * np.full((rows, 1), across),
        np.arange(rows)[:, None] * np.full(columns, along),
    )
    return np.stack([slopes.change(ramp.astype(np.float32)) for ramp in ramps], axis=-1)
