"""Pairs of robot pose and target pose from a detector (instead of pixels), and a model of their noise.

A detector measures a target's position well across the view, but badly in depth and tilt. A rotation error of
the robot displaces a distant target by much. Which of both dominates differs between data sets by a factor of
a hundred. So six standard deviations of robot and detector are estimated from the residuals (restricted
maximum likelihood of Gaussian residuals), with a wide prior that matters only for few poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from calibration.hand_eye.closed_form import Transforms
from calibration.hand_eye.refine import cross_matrices
from calibration.hand_eye.samples import Setup
from calibration.poses import REACH_M, pose_fault, repeated_pose
from drivers.types import Pose

Array = NDArray[np.floating]

USUAL_NOISE = np.array([np.radians(0.03), 3e-4, np.radians(0.2), np.radians(0.2), 1e-3, 3e-3])
"""Robot: rotation (rad), position (m). Detector: tilt, rotation about the axis (rad), across, depth (m)."""
_WIDE = np.array([1.2, 1.2, 2.5, 2.5, 2.5, 2.5])
"""One sigma of the prior of each logarithm."""
_LEAST, _MOST = 1e-3, 1e3
"""Limits of the estimated noise, as multiples of `USUAL_NOISE`."""


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One moment: `base_T_tcp` from the robot, and `camera_T_target` from a detector."""

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    camera_T_target: Pose  # noqa: N815


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """The samples as arrays. Both setups satisfy A_i Z = X B_i, as in `samples.Problem`.

    a_R, b_R: (N, 3, 3); a_t, b_t: (N, 3) m. B is camera_T_target.
    """

    ids: tuple[str, ...]
    a_R: Array  # noqa: N815
    a_t: Array
    b_R: Array  # noqa: N815
    b_t: Array
    setup: Setup

    def subset(self, rows: NDArray[np.int64]) -> "PosePairs":
        ids = tuple(self.ids[i] for i in rows)
        return PosePairs(ids, self.a_R[rows], self.a_t[rows], self.b_R[rows], self.b_t[rows], self.setup)


def make_pairs(samples: Sequence[PoseSample], setup: Setup) -> PosePairs:
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
    """Return why a sample cannot be used, or None. others: the samples accepted so far."""
    if any(other.id == sample.id for other in others[-1:]):
        return f"a second sample with the id {sample.id}"
    return pose_fault(sample.base_T_tcp, "robot pose", REACH_M) or pose_fault(
        sample.camera_T_target, "target's pose"
    )


def repeated_pair(sample: PoseSample, others: list[PoseSample]) -> str | None:
    """Return that a sample repeats the robot pose of an accepted one, or None."""
    return repeated_pose(sample.base_T_tcp, ((other.id, other.base_T_tcp) for other in others))


def pair_residuals(pairs: PosePairs, at: Transforms) -> tuple[Array, Array]:
    """Return residuals (N, 6) and their derivatives (N, 6, 12).

    A residual is the rotation (rad) and displacement (m) from the measured to the predicted target, in camera
    axes. Columns as in `refine.linearised`: rotation and translation of X, then of Z.
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
    """Return (N, 6, 6): the effect of a twist of the tool (rotation, translation, own axes) on the residual.

    If the camera is on the tool, a rotation of the tool displaces a distant target by much.
    """
    if pairs.setup is Setup.EYE_TO_HAND:
        to_camera, lever = at.x_R.T @ pairs.a_R, np.broadcast_to(at.z_t, pairs.a_t.shape)
    else:
        to_camera, lever = np.broadcast_to(-at.x_R.T, pairs.a_R.shape), pairs.a_R @ at.z_t + pairs.a_t
    effect = np.zeros((len(lever), 6, 6))
    effect[:, :3, :3] = effect[:, 3:, 3:] = to_camera
    effect[:, 3:, :3] = -to_camera @ cross_matrices(lever)
    return effect


def noise_parts(robot: Array) -> Array:
    """Return (6, N, 6, 6): the covariance of each pair's residual for one unit of each standard deviation.

    robot: (N, 6, 6), the effect of a twist of the robot on the residual.
    """
    parts = [robot[:, :, axes] @ robot[:, :, axes].transpose(0, 2, 1) for axes in (slice(3), slice(3, 6))]
    for axes in ([0, 1], [2], [3, 4], [5]):
        part = np.zeros((6, 6))
        part[axes, axes] = 1.0
        parts.append(np.broadcast_to(part, (len(robot), 6, 6)))
    return np.array(parts)


def covariances(parts: Array, sigmas: Array) -> Array:
    """Return the residuals' covariances (N, 6, 6) for (6,) standard deviations; parts: `noise_parts`."""
    return np.einsum("k,knij->nij", sigmas**2, parts)


def fit_noise(parts: Array, residuals: Array, weights: Array, parameters: int, start: Array) -> Array:
    """Return the (6,) standard deviations that explain (N, 6) residuals best, with (N,) weights.

    parts: from `noise_parts`. parameters: number fitted to the residuals, which made the residuals smaller.
    start: initial standard deviations.
    """
    count = residuals.size
    quadratic = weights * count / max(count - parameters, 1)

    def cost(logs: Array) -> tuple[float, Array]:
        sigmas = USUAL_NOISE * np.exp(logs)
        combined = covariances(parts, sigmas)
        inverse = np.linalg.inv(combined)
        white = (inverse @ residuals[..., None])[..., 0]
        value = 0.5 * np.linalg.slogdet(combined)[1].sum()
        value += 0.5 * float(quadratic @ (residuals * white).sum(axis=1))
        by_part = np.einsum("nij,knji->k", inverse, parts)
        by_part -= np.einsum("n,ni,knij,nj->k", quadratic, white, parts, white)
        prior = logs / _WIDE**2
        return value + 0.5 * float(logs @ prior), sigmas**2 * by_part + prior

    limits = [(np.log(_LEAST), np.log(_MOST))] * len(USUAL_NOISE)
    found = minimize(cost, np.log(start / USUAL_NOISE), jac=True, method="L-BFGS-B", bounds=limits)
    return USUAL_NOISE * np.exp(found.x)
