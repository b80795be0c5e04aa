"""Estimate centre and angle of a rotation by least squares from the displacements of points.

After Kolamuri, Si, Zhang, Agarwal and Yuan, "Improving grasp stability with rotation measurement from tactile
sensing" (IROS 2021, arXiv:2108.00301). In a rotation every point moves at right angles to its ray from the
centre. Therefore the perpendicular bisectors of all displacements meet in the centre, also for large
rotations. With the centre known, the angle is the only unknown.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError

MIN_POINTS = 3
# Smallest rms displacement that has a direction: positions of markers are accurate to 0.1 to 0.2 px.
NOISE_PX = 0.15
# Points count as collinear if their spread across a line is below this fraction of the spread along it. If
# the centre is on that line, the perpendicular bisectors of their displacements coincide.
LEAST_SPREAD = 0.1

Points = NDArray[np.float64]


class Degenerate(StrEnum):
    """Reason why displacements have no centre of rotation."""

    TOO_FEW = "fewer than 3 points were found before and after"
    COLLINEAR = "the points are on one line"
    STILL = "the points have not moved"
    TRANSLATION = "all points moved in the same way: a translation without rotation"


@dataclass(frozen=True, slots=True)
class Rotation:
    """A rotation. centre_px: (x, y), x to the right, y down. angle_rad: counter-clockwise positive."""

    centre_px: tuple[float, float]
    angle_rad: float


def find_rotation(before_px: Points, after_px: Points) -> Rotation | Degenerate:
    """Return the rotation between two sets of points, or the reason why there is none.

    before_px, after_px: (N, 2), x to the right, y down. The angle is within +-pi. Raises `InputError` for
    different shapes, or for NaN or infinite values.
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
    """Return the least-squares angle between rays (N, 2) from the centre, rad, counter-clockwise positive."""
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
        raise InputError(f"points have the shapes {before.shape} and {after.shape}: both have to be (N, 2)")
    if not (np.isfinite(before).all() and np.isfinite(after).all()):
        raise InputError("points have values that are not finite: leave out points that were not found")
