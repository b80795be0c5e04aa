"""Closed-form solutions of A Z = X B, in numpy because OpenCV 5.0 lacks them in Python (opencv #29565).

Each takes (N, 3, 3) and (N, 3) arrays of A and B, and returns X and Z. They initialise the refinement. They
are not final results, because they weight errors in depth and across the view equally, although a picture
measures depth much worse.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.observability import pair_indices, rotation_system

Array = NDArray[np.floating]


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
    first, second = pair_indices(len(turns))
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
