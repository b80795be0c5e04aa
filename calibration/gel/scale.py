"""Pixels to millimetres on the gel, along x and along y: the contact moved by known steps.

The two scales differ in real sensors (11.7 and 10.8 px per mm were reported for one), so one
number for both is not enough.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.verdict import Judgement, floor, limit
from drivers.errors import CalibrationError

Array = NDArray[np.floating]

FEWEST = 4


@dataclass(frozen=True, slots=True, eq=False)
class GelScale:
    """A gel's scale.

    mm_per_px: (2,) along x and y of the picture; sigma: (2,) one sigma of each. turn_deg: of the
    picture against the motion's axes. residual_px: rms. held_out_px: rms by leave-one-out.
    """

    mm_per_px: Array
    sigma: Array
    turn_deg: float
    residual_px: float
    held_out_px: float
    judgement: Judgement


def fit_scale(moves_mm: Array, centres_px: Array) -> GelScale:
    """Fit an affine map of known moves (N, 2) mm to contact centres (N, 2) px.

    Raises `CalibrationError` for fewer than four places, numbers not finite, or moves along one line.
    """
    if moves_mm.shape != centres_px.shape or moves_mm.ndim != 2 or moves_mm.shape[1] != 2:
        raise CalibrationError("gel scale: (N, 2) moves in mm and as many centres in px are needed")
    if not (np.isfinite(moves_mm).all() and np.isfinite(centres_px).all()):
        raise CalibrationError("gel scale: a move or a centre is not finite")
    centred = moves_mm - moves_mm.mean(axis=0) if len(moves_mm) >= 2 else np.zeros((2, 2))
    spread = np.linalg.svd(centred, compute_uv=False)
    if len(moves_mm) < FEWEST or spread[-1] < 0.1 * spread[0] or spread[-1] < 0.1:
        raise CalibrationError(
            f"gel scale: {len(moves_mm)} places that do not span both axes; press at {FEWEST} places "
            "at least, some mm apart along x and along y"
        )
    affine, missed = _affine(moves_mm, centres_px)
    held_out = []
    for i in range(len(moves_mm)):
        others = np.delete(np.arange(len(moves_mm)), i)
        left, _ = _affine(moves_mm[others], centres_px[others])
        held_out.append(centres_px[i] - np.append(moves_mm[i], 1.0) @ left)
    return _scale(affine, missed, np.array(held_out), moves_mm)


def _affine(moves_mm: Array, centres_px: Array) -> tuple[Array, Array]:
    """(3, 2) map of (move, 1) to px, and what it misses (N, 2) px."""
    system = np.column_stack([moves_mm, np.ones(len(moves_mm))])
    affine, *_ = np.linalg.lstsq(system, centres_px, rcond=None)
    return affine, centres_px - system @ affine


def _scale(affine: Array, missed: Array, held_out: Array, moves_mm: Array) -> GelScale:
    """Lengths of a picture's x and y axis in mm, from the inverse of the linear part."""
    mm_per_px_axes = np.linalg.inv(affine[:2])
    scale = np.linalg.norm(mm_per_px_axes, axis=1)
    noise = float(np.sqrt((missed**2).sum() / max(2 * len(missed) - 6, 1)))
    reach = float(np.linalg.svd(moves_mm - moves_mm.mean(axis=0), compute_uv=False)[-1])
    sigma = scale**2 * noise / reach
    turn = float(np.degrees(np.arctan2(affine[0, 1], affine[0, 0])))
    residual = float(np.sqrt((missed**2).sum(axis=1).mean()))
    left_out = float(np.sqrt((held_out**2).sum(axis=1).mean()))
    judged = limit(residual, 2.0, 15.0, "contact centres miss the known moves by {value:.1f} px")
    judged += limit(100 * float((sigma / scale).max()), 2.0, 20.0, "the scale is known to {value:.1f} % only")
    judged += floor(len(missed), 6, FEWEST, "{value} places; 9 are good")
    return GelScale(scale, sigma, turn, residual, left_out, judged)
