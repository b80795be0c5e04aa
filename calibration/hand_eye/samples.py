"""Samples of a hand-eye calibration: robot pose and picture, paired by id and checked before solving."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.poses import REACH_M, pose_fault, repeated_pose
from calibration.targets.boards import View, outside
from calibration.verdict import Rejected, sift
from drivers.errors import CalibrationError, counted
from drivers.types import Pose

Array = NDArray[np.floating]


class Setup(StrEnum):
    """Where the camera is mounted.

    Eye to hand: the camera is fixed, the target is on the tool; the answer is base_T_camera.
    Eye in hand: the camera is on the tool, the target is fixed; the answer is tcp_T_camera.
    """

    EYE_TO_HAND = "eye-to-hand"
    EYE_IN_HAND = "eye-in-hand"


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeSample:
    """One moment at rest: `base_T_tcp` from the robot, and the target in the camera's picture."""

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    view: View


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The samples as arrays. Both setups satisfy A_i Z = X B_i.

    X is the result (base_T_camera or tcp_T_camera), Z the pose of the target (tcp_T_target or base_T_target).
    A is base_T_tcp for eye to hand, tcp_T_base for eye in hand. a_R: (N, 3, 3); a_t: (N, 3) m. points_m: (M,
    3) on the target. seen_px: (M, 2) px in the picture of `camera`; pixels: the same, undistorted. owner:
    (M,) index of each point's sample.
    """

    ids: tuple[str, ...]
    a_R: Array  # noqa: N815
    a_t: Array
    points_m: Array
    seen_px: Array
    pixels: Array
    owner: NDArray[np.int64]
    camera: CameraModel

    @property
    def focal(self) -> Array:
        """Focal lengths, (2,) px."""
        return self.camera.matrix[[0, 1], [0, 1]]

    @property
    def centre(self) -> Array:
        """Principal point, (2,) px."""
        return self.camera.matrix[:2, 2]

    def seen_by(self, camera: CameraModel) -> "Problem":
        """Return the problem with the same pictures, but another camera's calibration."""
        return replace(self, pixels=camera.undistorted(self.seen_px), camera=camera)

    def without(self, sample: int) -> "Problem":
        return self.subset(np.delete(np.arange(len(self.ids)), sample))

    def subset(self, samples: NDArray[np.int64]) -> "Problem":
        """Return the problem with only these samples, in this order."""
        rows = [np.flatnonzero(self.owner == i) for i in samples]
        chosen = np.concatenate(rows) if rows else np.empty(0, np.int64)
        owner = np.repeat(np.arange(len(samples)), [len(r) for r in rows])
        return Problem(
            tuple(self.ids[i] for i in samples), self.a_R[samples], self.a_t[samples],
            self.points_m[chosen], self.seen_px[chosen], self.pixels[chosen], owner, self.camera,
        )  # fmt: skip

    def inverted(self) -> "Problem":
        """Return the problem with all robot poses inverted."""
        turned = self.a_R.transpose(0, 2, 1)
        return replace(self, a_R=turned, a_t=-(turned @ self.a_t[..., None])[..., 0])

    def shifted(self, by: int) -> "Problem":
        """Return the problem with poses and pictures paired with an offset."""
        return replace(self, a_R=np.roll(self.a_R, by, axis=0), a_t=np.roll(self.a_t, by, axis=0))


def make_problem(samples: Sequence[HandEyeSample], camera: CameraModel, setup: Setup) -> Problem:
    """Collect samples into arrays, with undistorted pixels."""
    poses = [s.base_T_tcp if setup is Setup.EYE_TO_HAND else s.base_T_tcp.inverse() for s in samples]
    seen = np.vstack([s.view.image_px for s in samples])
    return Problem(
        ids=tuple(s.id for s in samples),
        a_R=np.array([p.rotation.as_matrix() for p in poses]),
        a_t=np.array([p.position_m for p in poses]),
        points_m=np.vstack([s.view.board_m for s in samples]),
        seen_px=seen,
        pixels=camera.undistorted(seen),
        owner=np.repeat(np.arange(len(samples)), [len(s.view.ids) for s in samples]),
        camera=camera,
    )


def target_poses(problem: Problem) -> tuple[Array, Array]:
    """Return camera_T_target per sample and solution: (N, 2, 3, 3) and (N, 2, 3) m, the better-fitting first.

    A flat target allows two poses that look almost alike (IPPE, Collins and Bartoli 2014); a single picture
    of a small marker cannot distinguish them. Raises `CalibrationError`.
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
    """(N,) index of the pose that is nearer to the (N, 3, 3) expected orientations."""
    agreement = np.einsum("nkij,nij->nk", turns, expected)
    return np.argmax(agreement, axis=1)


def usable_samples(
    samples: Sequence[HandEyeSample], camera: CameraModel
) -> tuple[list[HandEyeSample], list[Rejected]]:
    """Separate usable samples from unusable ones, each of these with its reason."""
    return sift(samples, lambda s: s.id, lambda s, kept: _fault(s, camera) or _repeats(s, kept))


def _fault(sample: HandEyeSample, camera: CameraModel) -> str | None:
    view = sample.view
    if not (np.isfinite(view.image_px).all() and np.isfinite(view.board_m).all()):
        return "a corner is NaN or infinite"
    if len(view.ids) < 4:
        return f"{counted(len(view.ids), 'point')} of the target seen, at least 4 are needed"
    if view.size != camera.size:
        return f"picture of {view.size} px, the camera was calibrated at {camera.size}"
    beyond = outside(view)
    if beyond is not None:
        return beyond
    spread = np.linalg.svd(view.image_px - view.image_px.mean(axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        return "all points seen lie on one line"
    return pose_fault(sample.base_T_tcp, "robot pose", REACH_M)


def _repeats(sample: HandEyeSample, others: list[HandEyeSample]) -> str | None:
    """Reject a repeated pose: it adds no information, and makes leave-one-out meaningless."""
    if any(other.id == sample.id for other in others):
        return f"a second sample with the id {sample.id}"
    return repeated_pose(sample.base_T_tcp, ((other.id, other.base_T_tcp) for other in others))
