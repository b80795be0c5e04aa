"""Whether robot motions determine a hand-eye transform, and closed-form solutions of A Z = X B.

`observability` returns three numbers, none of which is sufficient alone.

The solutions are in numpy because OpenCV 5.0 lacks them in Python (opencv #29565). Each takes (N, 3, 3) and
(N, 3) arrays of A and B, and returns X and Z. They initialise the refinement. They are not final results,
because they weight errors in depth and across the view equally, although a picture measures depth much worse.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.verdict import Assessment, floor

Array = NDArray[np.floating]

LEAST_TURN_DEG, LEAST_RATIO, LEAST_GAP = 20.0, 0.2, 1e-2
"""Smallest `max_angle_deg`, `translation_ratio` and `rotation_gap` of a good calibration."""
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


def observability(a_R: Array) -> Observability:  # noqa: N803
    """Measure the motions between all pairs of (N, 3, 3) robot orientations."""
    first, second = np.triu_indices(len(a_R), 1)
    if len(first) == 0:
        return Observability(0.0, 0.0, 0.0, 0.0)
    turns = a_R[second] @ a_R[first].transpose(0, 2, 1)
    angles = np.degrees(Rotation.from_matrix(turns).magnitude())
    turning = angles[angles > 1.0]
    strengths = np.linalg.svd((turns - np.eye(3)).reshape(-1, 3), compute_uv=False)
    ratio = 0.0 if strengths[0] < 1e-9 else float(strengths[-1] / strengths[0])
    squares = np.linalg.svd(rotation_system(turns, turns), compute_uv=False) ** 2
    gap = 0.0 if squares[0] < 1e-12 else float(squares[-2] / squares[0])
    return Observability(float(angles.max()), float(turning.min()) if len(turning) else 0.0, ratio, gap)


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
            floor(
                seen.max_angle_deg, LEAST_TURN_DEG, 5.0,
                "the tool rotated by at most {value:.1f} degrees: " + _HINT,
            )
            + floor(
                seen.translation_ratio, LEAST_RATIO, 0.01,
                "rotations are about nearly parallel axes (ratio {value:.2f}): " + _HINT,
                "how far the axes of rotation differ, as a ratio: {value:.2f}",
            )
            + floor(
                seen.rotation_gap, LEAST_GAP, 1e-4,
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


@dataclass(frozen=True, slots=True, eq=False)
class Transforms:
    """X and Z as rotation matrices (3, 3) and translations (3,) in m."""

    x_R: Array  # noqa: N815
    x_t: Array
    z_R: Array  # noqa: N815
    z_t: Array


def park(a_R: Array, a_t: Array, b_R: Array, b_t: Array) -> Transforms:  # noqa: N803
    """Park and Martin 1994 over all pairs: rotation from axis-angle vectors, then translation."""
    pa_R, _ = motions(a_R, a_t)  # noqa: N806
    pb_R, _ = motions(b_R, b_t)  # noqa: N806
    alpha, beta = Rotation.from_matrix(pa_R).as_rotvec(), Rotation.from_matrix(pb_R).as_rotvec()
    x_R = nearest_rotation(alpha.T @ beta)  # noqa: N806
    return _with_translations(x_R, a_R, a_t, b_R, b_t)


def kronecker(a_R: Array, a_t: Array, b_R: Array, b_t: Array) -> Transforms:  # noqa: N803
    """Null vector of the linear rotation system over all pairs (Andreff et al. 1999)."""
    pa_R, _ = motions(a_R, a_t)  # noqa: N806
    pb_R, _ = motions(b_R, b_t)  # noqa: N806
    _, _, right = np.linalg.svd(rotation_system(pa_R, pb_R), full_matrices=False)
    x = right[-1].reshape(3, 3)
    x_R = nearest_rotation(x * np.sign(np.linalg.det(x) or 1.0))  # noqa: N806
    return _with_translations(x_R, a_R, a_t, b_R, b_t)


def shah(a_R: Array, a_t: Array, b_R: Array, b_t: Array) -> Transforms:  # noqa: N803
    """Shah 2013: rotations of X and Z from one SVD of the sum of Kronecker products, then translations."""
    total = np.einsum("nij,nkl->ikjl", a_R, b_R).reshape(9, 9)
    left, _, right = np.linalg.svd(total)
    x, z = left[:, 0].reshape(3, 3), right[0].reshape(3, 3)
    x_R, z_R = (nearest_rotation(m * np.sign(np.linalg.det(m) or 1.0)) for m in (x, z))  # noqa: N806
    count = len(a_R)
    system = np.concatenate([a_R, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, 6)
    both, *_ = np.linalg.lstsq(system, (b_t @ x_R.T - a_t).reshape(-1), rcond=None)
    return Transforms(x_R, both[3:], z_R, both[:3])


CLOSED_FORMS = {"park": park, "kronecker": kronecker, "shah": shah}


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation nearest to a (3, 3) matrix; never a reflection."""
    left, _, right = np.linalg.svd(matrix)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    return left @ mirror @ right


def motions(turns: Array, moves: Array) -> tuple[Array, Array]:
    """Return the motions between all pairs of poses: T_j T_i^-1."""
    first, second = np.triu_indices(len(turns), 1)
    relative = turns[second] @ turns[first].transpose(0, 2, 1)
    return relative, moves[second] - (relative @ moves[first][..., None])[..., 0]


def _with_translations(x_R: Array, a_R: Array, a_t: Array, b_R: Array, b_t: Array) -> Transforms:  # noqa: N803
    """Solve the translation of X from (R_A - I) t = X t_B - t_A over all pairs; Z is the sample mean."""
    pa_R, pa_t = motions(a_R, a_t)  # noqa: N806
    _, pb_t = motions(b_R, b_t)
    x_t, *_ = np.linalg.lstsq(
        (pa_R - np.eye(3)).reshape(-1, 3), (pb_t @ x_R.T - pa_t).reshape(-1), rcond=None
    )
    back = a_R.transpose(0, 2, 1)
    z_R = nearest_rotation((back @ x_R @ b_R).mean(axis=0))  # noqa: N806
    z_t = (back @ (b_t @ x_R.T + x_t - a_t)[..., None])[..., 0].mean(axis=0)
    return Transforms(x_R, x_t, z_R, z_t)
