"""The target's pose in each single picture: where the closed forms start from."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.samples import Problem
from drivers.errors import CalibrationError

Array = NDArray[np.floating]


def target_poses(problem: Problem) -> tuple[Array, Array]:
    """camera_T_target per sample and solution: (N, 2, 3, 3) and (N, 2, 3) m, the better-fitting first.

    A flat target allows two poses that look almost alike (IPPE, Collins and Bartoli 2014); which
    one it is, one picture of a small marker cannot tell. Raises `CalibrationError`.
    """
    turns, moves = [], []
    for i, name in enumerate(problem.ids):
        mine = problem.owner == i
        flat = (problem.pixels[mine] - problem.centre) / problem.focal
        try:
            count, rotations, translations, _ = cv2.solvePnPGeneric(
                problem.points_m[mine], flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
            )
        except cv2.error as error:
            raise CalibrationError(
                f"hand-eye: sample {name}: no pose of the target fits ({error.err})"
            ) from error
        if count == 0 or not np.isfinite(np.array(rotations)).all():
            raise CalibrationError(f"hand-eye: sample {name}: no pose of the target fits its corners")
        turns.append(
            Rotation.from_rotvec(np.array([r.ravel() for r in (rotations[0], rotations[-1])])).as_matrix()
        )
        moves.append([t.ravel() for t in (translations[0], translations[-1])])
    return np.array(turns), np.array(moves, np.float64)


def consistent_choice(turns: Array, expected: Array) -> NDArray[np.int64]:
    """(N,) which of the two poses is nearer to the (N, 3, 3) expected orientation."""
    agreement = np.einsum("nkij,nij->nk", turns, expected)
    return np.argmax(agreement, axis=1)
