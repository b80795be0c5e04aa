"""Pairs of poses: the robot's, and the target's as a detector gave it instead of pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.closed_form import Transforms
from calibration.hand_eye.refine import cross_matrices
from calibration.hand_eye.samples import Setup
from calibration.poses import pose_fault
from drivers.types import Pose

Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One moment: `base_T_tcp` as the robot says, and `camera_T_target` as somebody's detector says."""

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    camera_T_target: Pose  # noqa: N815


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """The samples as arrays. Both setups read A_i Z = X B_i, as in `samples.Problem`.

    a_R, b_R: (N, 3, 3); a_t, b_t: (N, 3) m. B is camera_T_target.
    """

    ids: tuple[str, ...]
    a_R: Array  # noqa: N815
    a_t: Array
    b_R: Array  # noqa: N815
    b_t: Array
    setup: Setup

    def subset(self, rows: NDArray[np.int64]) -> "PosePairs":
        """These pairs only, in this order."""
        ids = tuple(self.ids[i] for i in rows)
        return PosePairs(ids, self.a_R[rows], self.a_t[rows], self.b_R[rows], self.b_t[rows], self.setup)


def make_pairs(samples: Sequence[PoseSample], setup: Setup) -> PosePairs:
    """Collect samples into arrays."""
    to_hand = setup is Setup.EYE_TO_HAND
    robot = [s.base_T_tcp if to_hand else s.base_T_tcp.inverse() for s in samples]
    seen = [s.camera_T_target for s in samples]
    return PosePairs(
        tuple(s.id for s in samples),
        np.array([p.rotation.as_matrix() for p in robot]).reshape(-1, 3, 3),
        np.array([p.position_m for p in robot]).reshape(-1, 3),
        np.array([p.rotation.as_matrix() for p in seen]).reshape(-1, 3, 3),
        np.array([p.position_m for p in seen]).reshape(-1, 3),
        setup,
    )


def sample_fault(sample: PoseSample, others: list[PoseSample]) -> str | None:
    """Say why a sample cannot be used, or None; others: those kept so far."""
    if any(other.id == sample.id for other in others[-1:]):
        return f"a second sample with the id {sample.id}"
    return pose_fault(sample.base_T_tcp, "robot pose") or pose_fault(sample.camera_T_target, "target's pose")


def pair_residuals(pairs: PosePairs, at: Transforms) -> tuple[Array, Array]:
    """(N, 6) turn (rad) and move (m) from measured to predicted target, in camera axes; (N, 6, 12) by steps.

    Columns as of `refine.linearised`: turn and move of X, then of Z.
    """
    to_camera = at.x_R.T @ pairs.a_R
    predicted_R = to_camera @ at.z_R  # noqa: N806
    predicted_t = (pairs.a_R @ at.z_t + pairs.a_t - at.x_t) @ at.x_R
    turn = Rotation.from_matrix(predicted_R @ pairs.b_R.transpose(0, 2, 1)).as_rotvec()
    by_step = np.zeros((len(turn), 6, 12))
    by_step[:, :3, :3] = -np.eye(3)
    by_step[:, :3, 6:9] = predicted_R
    by_step[:, 3:, :3] = cross_matrices(predicted_t)
    by_step[:, 3:, 3:6] = -at.x_R.T
    by_step[:, 3:, 9:] = to_camera
    return np.concatenate([turn, predicted_t - pairs.b_t], axis=1), by_step


def by_robot(pairs: PosePairs, at: Transforms) -> Array:
    """(N, 6, 6): what a twist of the tool (turn, move, about its own axes) does to the residual.

    With the camera on the tool, a turn of the tool moves a far target far.
    """
    if pairs.setup is Setup.EYE_TO_HAND:
        to_camera, lever = at.x_R.T @ pairs.a_R, np.broadcast_to(at.z_t, pairs.a_t.shape)
    else:
        to_camera, lever = np.broadcast_to(-at.x_R.T, pairs.a_R.shape), pairs.a_R @ at.z_t + pairs.a_t
    effect = np.zeros((len(lever), 6, 6))
    effect[:, :3, :3] = effect[:, 3:, 3:] = to_camera
    effect[:, 3:, :3] = -to_camera @ cross_matrices(lever)
    return effect
