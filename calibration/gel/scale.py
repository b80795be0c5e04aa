"""Millimetres per pixel on the gel, along x and along y, from a contact moved by known steps.

The two scales differ in real sensors (11.7 and 10.8 px per mm were reported for one), so one
number does not do for both. A gel is convex: where a ball touches it first lies nearer to the
gel's top than the ball, by 1 + R / (gel's radius). Balls of two sizes determine it, and the
scale is extrapolated to a ball of radius zero.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibration.verdict import Assessment, floor, limit
from drivers.errors import CalibrationError

Array = NDArray[np.floating]

FEWEST = 4
_SIZES_APART = 1.2
_MOST_BULGE_PER_MM = 0.1
"""One over the smallest radius of curvature of a gel that is considered: 10 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class GelScale:
    """A gel's scale.

    mm_per_px: (2,) along x and y of the picture; sigma: (2,) one sigma of each; aspect_sigma: of
    their ratio, in which the bulge cancels. residual_px: rms.
    centres_px, missed_px: (N, 2) the contact centres, and the residual of each.
    """

    mm_per_px: Array
    sigma: Array
    aspect_sigma: float
    residual_px: float
    centres_px: Array
    missed_px: Array
    assessment: Assessment

    @property
    def pixel_aspect(self) -> float:
        """Width over height of a pixel on the gel."""
        return float(self.mm_per_px[0] / self.mm_per_px[1])


def fit_scale(moves_mm: Array, centres_px: Array, radii_mm: Array | None = None) -> GelScale:
    """Fit moves (N, 2) mm, x right and y down as the picture shows them, over contact centres (N, 2) px.

    radii_mm: (N,) of the balls; with two sizes a fifth apart the gel's bulge is fitted too. Raises
    `CalibrationError` for fewer than four places, numbers not finite, or moves along one line.
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
    apart = radii_mm is not None and np.max(radii_mm) >= _SIZES_APART * np.min(radii_mm)
    radii = np.asarray(radii_mm, np.float64) if apart else np.zeros(len(moves_mm))
    return _scale(centres_px, moves_mm, radii)


def _fit(centres_px: Array, moves_mm: Array, radii_mm: Array) -> tuple[Array, Array]:
    """(2,) mm per px along x and y, and the (N, 2) residuals of the moves in mm."""

    def solve(bulge_per_mm: float) -> tuple[Array, Array]:
        stretched = centres_px * (1.0 + bulge_per_mm * radii_mm[:, None])
        zeros = [np.ones(len(radii_mm)), *([radii_mm] if radii_mm.any() else [])]
        system = np.column_stack([stretched, *zeros])
        weights = np.linalg.lstsq(system, moves_mm, rcond=None)[0]
        return np.linalg.norm(weights[:2], axis=1), moves_mm - system @ weights

    if not radii_mm.any():
        return solve(0.0)
    found: Any = minimize_scalar(
        lambda bulge_per_mm: float((solve(bulge_per_mm)[1] ** 2).sum()),
        bounds=(0.0, _MOST_BULGE_PER_MM),
        method="bounded",
    )
    return solve(float(found.x))


def _scale(centres_px: Array, moves_mm: Array, radii_mm: Array) -> GelScale:
    """Lengths in mm of one pixel along x and y, with their sigma by jackknife."""
    scale, missed = _fit(centres_px, moves_mm, radii_mm)
    count = len(missed)
    left_out = [np.delete(np.arange(count), i) for i in range(count)]
    scales = np.array([_fit(centres_px[o], moves_mm[o], radii_mm[o])[0] for o in left_out])
    spread = scales - scales.mean(axis=0)
    sigma = np.sqrt((count - 1) / count * (spread**2).sum(axis=0))
    aspects = scales[:, 0] / scales[:, 1]
    aspect_sigma = float(np.sqrt((count - 1) / count * ((aspects - aspects.mean()) ** 2).sum()))
    residual_px = float(np.sqrt((missed**2).sum(axis=1).mean()) / scale.mean())
    assessment = limit(residual_px, 2.0, 15.0, "contact centres miss the known moves by {value:.1f} px")
    assessment += limit(
        100 * float((sigma / scale).max()), 2.0, 20.0, "the scale is known to {value:.1f} % only"
    )
    assessment += floor(count, 6, FEWEST, "{value} places; 9 are good")
    return GelScale(scale, sigma, aspect_sigma, residual_px, centres_px, missed / scale, assessment)
