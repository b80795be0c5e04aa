"""Centre and angle of a rotation by least squares from the displacement of points.

After Kolamuri, Si, Zhang, Agarwal and Yuan, "Improving grasp stability with rotation measurement from
tactile sensing" (IROS 2021, arXiv:2108.00301): a turning point moves at right angles to its ray from
the centre, so the normals of all displacements meet there; with the centre known, one angle is left.
The normals are drawn at the middles of the displacements, which makes the centre exact for any turn.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError

MIN_POINTS = 3
# Places of markers are known to a tenth of a pixel or two: smaller motions tell no direction.
NOISE_PX = 0.15
# Points whose spread across is below this share of the spread along lie on a line: the normals of their
# displacements are one and the same line where the centre lies on it too.
LEAST_SPREAD = 0.1

Points = NDArray[np.float64]


class Degenerate(StrEnum):
    """Why displacements have no centre of rotation."""

    TOO_FEW = "fewer than 3 points were seen before and after"
    COLLINEAR = "the points lie on one line"
    STILL = "the points have not moved"
    TRANSLATION = "all points moved alike: a shift, no turn"


@dataclass(frozen=True, slots=True)
class Rotation:
    """A turn. centre_px: (x, y), x right, y down. angle_rad: counter-clockwise positive as seen."""

    centre_px: tuple[float, float]
    angle_rad: float


def find_rotation(before_px: Points, after_px: Points) -> Rotation | Degenerate:
    """Return the rotation that took points (N, 2) to (N, 2), x right and y down, or why there is none.

    The angle is within +-pi. Raises `InputError` for shapes that differ or values that are not finite.
    """
    before, after = np.asarray(before_px, np.float64), np.asarray(after_px, np.float64)
    _check(before, after)
    if len(before) < MIN_POINTS:
        return Degenerate.TOO_FEW
    along, across = np.linalg.svd(before - before.mean(axis=0), compute_uv=False)
    if across <= LEAST_SPREAD * along:
        return Degenerate.COLLINEAR
    moved = after - before
    if _rms(moved) < NOISE_PX:
        return Degenerate.STILL
    if _rms(moved - moved.mean(axis=0)) < NOISE_PX:
        return Degenerate.TRANSLATION
    centre = _centre(0.5 * (before + after), moved)
    return Rotation((float(centre[0]), float(centre[1])), turn_about(before - centre, after - centre))


def turn_about(before: Points, after: Points) -> float:
    """Return the least-squares angle, rad, counter-clockwise as seen, of rays (N, 2) from the centre."""
    across = (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum()
    return -math.atan2(float(across), float((before * after).sum()))


def _centre(middles: Points, moved: Points) -> Points:
    """Return the point nearest to all normals: moved . (centre - middle) = 0 for each point."""
    origin = middles.mean(axis=0)
    offsets = (moved * (middles - origin)).sum(axis=1)
    return origin + np.linalg.lstsq(moved, offsets, rcond=None)[0]


def _rms(vectors: Points) -> float:
    return math.sqrt(float(np.square(vectors).sum(axis=1).mean()))


def _check(before: Points, after: Points) -> None:
    if before.ndim != 2 or before.shape[1:] != (2,) or before.shape != after.shape:
        raise InputError(f"points of shapes {before.shape} and {after.shape}: both have to be (N, 2)")
    if not (np.isfinite(before).all() and np.isfinite(after).all()):
        raise InputError("points hold values that are not finite: leave points out that were not seen")
