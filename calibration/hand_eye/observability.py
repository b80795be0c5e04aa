"""Measure whether robot motions determine a hand-eye transform: three numbers, none sufficient alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.verdict import Assessment, floor

Array = NDArray[np.floating]

_HINT = "turn the tool by 30 degrees and more about two axes at least, between still poses"


@dataclass(frozen=True, slots=True)
class Observability:
    """The three numbers, and the smallest rotation.

    max_angle_deg: largest rotation between two poses. least_angle_deg: smallest rotation among pairs that
    rotate. translation_ratio: smallest over largest singular value of the stacked (R - I). rotation_gap:
    second smallest over largest eigenvalue of the rotation system R X = X R.
    """

    max_angle_deg: float
    least_angle_deg: float
    translation_ratio: float
    rotation_gap: float


def pair_indices(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices (i, j), i < j, of all pairs."""
    first, second = np.triu_indices(count, 1)
    return first, second


def observability(a_R: Array) -> Observability:  # noqa: N803
    """Measure the motions between all pairs of (N, 3, 3) robot orientations."""
    first, second = pair_indices(len(a_R))
    if len(first) == 0:
        return Observability(0.0, 0.0, 0.0, 0.0)
    turns = a_R[second] @ a_R[first].transpose(0, 2, 1)
    angles = np.degrees(Rotation.from_matrix(turns).magnitude())
    turning = angles[angles > 1.0]
    strengths = np.linalg.svd((turns - np.eye(3)).reshape(-1, 3), compute_uv=False)
    ratio = 0.0 if strengths[0] < 1e-9 else float(strengths[-1] / strengths[0])
    return Observability(
        float(angles.max()), float(turning.min()) if len(turning) else 0.0, ratio, _rotation_gap(turns)
    )


def assess_motion(seen: Observability) -> Assessment:
    """Refuse motions that leave a degree of freedom undetermined; doubt those that nearly do.

    All three numbers are needed: a pure translation passes two of them, rotations by 180 degrees the other
    two.
    """
    if seen.max_angle_deg < 5.0:
        reason = f"the tool rotated by at most {seen.max_angle_deg:.2f} degrees: {_HINT}"
    elif seen.rotation_gap < 1e-4 and seen.least_angle_deg > 150.0:
        reason = (
            "all rotations between poses are near 180 degrees, which allows mirror solutions: use 30 to 120"
        )
    elif seen.translation_ratio < 0.01 or seen.rotation_gap < 1e-4:
        reason = f"all rotations are about parallel axes: {_HINT}"
    else:
        return (
            floor(seen.max_angle_deg, 20.0, 5.0, "the tool rotated by at most {value:.1f} degrees: " + _HINT)
            + floor(
                seen.translation_ratio, 0.2, 0.01,
                "rotations are about nearly parallel axes (ratio {value:.2f}): " + _HINT,
                "how far the axes of rotation differ, as a ratio: {value:.2f}",
            )
            + floor(
                seen.rotation_gap, 1e-2, 1e-4,
                "the rotation is weakly determined (gap {value:.2g}): " + _HINT,
                "how well the rotations determine the orientation, as a gap of eigenvalues: {value:.2g}",
            )
        )  # fmt: skip
    return Assessment((reason,))


def rotation_system(a_R: Array, b_R: Array) -> Array:  # noqa: N803
    """Return (9 K, 9): R_A X - X R_B = 0 for row-major vec(X), over K pairs."""
    eye = np.eye(3)
    blocks = [np.kron(a, eye) - np.kron(eye, b.T) for a, b in zip(a_R, b_R, strict=True)]
    return np.vstack(blocks)


def _rotation_gap(turns: Array) -> float:
    system = rotation_system(turns, turns)
    strengths = np.linalg.svd(system, compute_uv=False) ** 2
    return 0.0 if strengths[0] < 1e-12 else float(strengths[-2] / strengths[0])
