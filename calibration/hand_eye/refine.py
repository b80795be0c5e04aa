"""Solutions of A Z = X B: closed forms, and least squares on pixels over X and Z together; their uncertainty.

Whether robot motions determine a hand-eye transform is measured by `observability`: three numbers, none of
which is sufficient alone. The closed forms are in numpy because OpenCV 5.0 lacks them in Python (opencv
#29565). Each takes (N, 3, 3) and (N, 3) arrays of A and B, and returns X and Z. They initialise the
refinement. They are not final results, because they weight errors in depth and across the view equally,
although a picture measures depth much worse.

The pose of one marker is uncertain in depth and tilt but accurate across the view, while pixel errors are
equal in both axes. Because the robot connects the views, fitting pixels is several times as accurate as
fitting poses.

The covariance of the fit ignores the robot's errors, which all points of a picture share. The jackknife
includes them, but is noisy for few samples. In each direction the larger one is used. Neither includes the
camera's own error, which is the same in all samples: a focal length wrong by 0.2 % displaces a camera at 0.9
m by 2 mm without larger residuals. So the change of the estimate with cameras that are wrong by one sigma is
added.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.verdict import Assessment, limits
from drivers.types import Pose

Array = NDArray[np.floating]

LEAST_TURN_DEG, LEAST_RATIO, LEAST_GAP = 20.0, 0.2, 1e-2
"""Smallest `max_angle_deg`, `translation_ratio` and `rotation_gap` of a good calibration."""
_HINT = "turn the tool by 30 degrees and more about two axes at least, between still poses"
_ROUNDS = 60
"""Most iterations of the refinement."""
_STILL = 1e-9
"""Relative change of the cost below which the iteration has converged."""
_NEAREST_M = 1e-3
"""Smallest depth used in a projection, so that points behind the camera do not divide by zero."""


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
        return limits(
            (seen.max_angle_deg, LEAST_TURN_DEG, 5.0,
             "the tool rotated by at most {value:.1f} degrees: " + _HINT),
            (seen.translation_ratio, LEAST_RATIO, 0.01,
             "rotations are about nearly parallel axes (ratio {value:.2f}): " + _HINT,
             "how far the axes of rotation differ, as a ratio: {value:.2f}"),
            (seen.rotation_gap, LEAST_GAP, 1e-4,
             "the rotation is weakly determined (gap {value:.2g}): " + _HINT,
             "how well the rotations determine the orientation, as a gap of eigenvalues: {value:.2g}"),
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

    @property
    def poses(self) -> tuple[Pose, Pose]:
        """X and Z."""
        pairs = ((self.x_R, self.x_t), (self.z_R, self.z_t))
        x, z = (Pose.from_rotation(move, Rotation.from_matrix(turn)) for turn, move in pairs)
        return x, z


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
        return self.camera.matrix[[0, 1], [0, 1]]

    @property
    def centre(self) -> Array:
        return self.camera.matrix[:2, 2]

    def subset(self, samples: NDArray[np.int64]) -> "Problem":
        """Return the problem with only these samples, in this order."""
        rows = [np.flatnonzero(self.owner == i) for i in samples]
        chosen = np.concatenate(rows) if rows else np.empty(0, np.int64)
        owner = np.repeat(np.arange(len(samples)), [len(r) for r in rows])
        return Problem(
            tuple(self.ids[i] for i in samples), self.a_R[samples], self.a_t[samples],
            self.points_m[chosen], self.seen_px[chosen], self.pixels[chosen], owner, self.camera,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The result of the iteration. missed_px: (M, 2) residuals. cost: the minimised sum."""

    transforms: Transforms
    missed_px: Array
    cost: float

    @property
    def rms_px(self) -> float:
        return float(np.sqrt((self.missed_px**2).sum(axis=1).mean()))

    def sample_rms_px(self, problem: Problem) -> Array:
        """Return the rms distance per sample, (N,), px."""
        squares = (self.missed_px**2).sum(axis=1)
        counts = np.bincount(problem.owner, minlength=len(problem.ids))
        return np.sqrt(np.bincount(problem.owner, squares, len(problem.ids)) / np.maximum(counts, 1))


def refine(problem: Problem, start: Transforms, soft_px: float | None = None) -> Refined:
    """Minimise by Levenberg-Marquardt. soft_px: width of a soft-L1 loss; None for squares.

    Steps rotate X and Z about their own axes and translate them. Columns are scaled before each solve, so
    that m and rad have similar weight. Stops when the cost has converged, after 60 rounds at the latest.
    """
    now, damping = start, 1e-4
    missed, jacobian = linearise(problem, now)
    cost, weights = _loss(missed, soft_px)
    for _ in range(_ROUNDS):
        step = _step(jacobian, missed, weights, damping)
        candidate = apply_step(now, step)
        new_missed, new_jacobian = linearise(problem, candidate)
        new_cost, new_weights = _loss(new_missed, soft_px)
        if new_cost <= cost:
            done = cost - new_cost <= _STILL * cost
            now, missed, jacobian, cost, weights = candidate, new_missed, new_jacobian, new_cost, new_weights
            damping = max(damping / 10.0, 1e-9)
            if done:
                break
        elif damping > 1e6:
            break
        else:
            damping *= 10.0
    return Refined(now, missed, cost)


def linearise(problem: Problem, at: Transforms) -> tuple[Array, Array]:
    """Return the residuals (M, 2) of the prediction, px, and their derivatives (M, 2, 12).

    Columns: rotation of X (about its own axes), translation of X (base or tcp axes), then of Z likewise.
    """
    a_R, a_t = problem.a_R[problem.owner], problem.a_t[problem.owner]  # noqa: N806
    carried = problem.points_m @ at.z_R.T + at.z_t
    seen = ((a_R @ carried[..., None])[..., 0] + a_t - at.x_t) @ at.x_R
    to_camera = at.x_R.T @ a_R
    by_pose = np.concatenate(
        [
            cross_matrices(seen),
            np.broadcast_to(-at.x_R.T, a_R.shape),
            -to_camera @ at.z_R @ cross_matrices(problem.points_m),
            to_camera,
        ],
        axis=2,
    )
    depth = np.where(seen[:, 2] > _NEAREST_M, seen[:, 2], _NEAREST_M)
    flat = seen[:, :2] / depth[:, None]
    missed = problem.focal * flat + problem.centre - problem.pixels
    scale = (problem.focal / depth[:, None])[..., None]
    return missed, scale * (by_pose[:, :2] - flat[..., None] * by_pose[:, 2:])


def apply_step(at: Transforms, step: Array) -> Transforms:
    turns = Rotation.from_rotvec(step.reshape(4, 3)[[0, 2]]).as_matrix()
    return Transforms(at.x_R @ turns[0], at.x_t + step[3:6], at.z_R @ turns[1], at.z_t + step[9:])


def cross_matrices(vectors: Array) -> Array:
    """(M, 3, 3) matrices of the cross product with each of (M, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _loss(missed: Array, soft_px: float | None) -> tuple[float, Array]:
    """Return the cost and the weights (M,) of points: squares, or soft-L1 of their distances."""
    squares = (missed**2).sum(axis=1)
    if soft_px is None:
        return float(squares.sum()), np.ones(len(missed))
    root = np.sqrt(1.0 + squares / soft_px**2)
    return float(2.0 * soft_px**2 * (root - 1.0).sum()), 1.0 / root


def _step(jacobian: Array, missed: Array, weights: Array, damping: float) -> Array:
    """Return the damped Gauss-Newton step by QR of the scaled, augmented system."""
    root = np.sqrt(weights)[:, None]
    rows = (jacobian * root[..., None]).reshape(-1, 12)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    system = np.vstack([rows / scale, np.sqrt(damping) * np.eye(12)])
    target = np.concatenate([-(missed * root).reshape(-1), np.zeros(12)])
    q, r = np.linalg.qr(system)
    return np.linalg.solve(r, q.T @ target) / scale


def uncertainty(problem: Problem, answer: Refined) -> tuple[Array, Array, Array]:
    """Return the covariance (6, 6) of X, the part of it that the camera causes, and held-out errors (N,) px.

    Covariances are of X's rotation vector about its own axes (rad), then its translation (m): the larger of
    fit and jackknife in each direction, plus the camera's part, which is zero if the camera is exact. A
    held-out error is the rms by which the estimate from all other samples misses a sample. Takes one short
    refit per sample, and per direction of the camera's covariance.
    """
    count = len(problem.ids)
    changes, held_out = np.zeros((count, 6)), np.zeros(count)
    for i in range(count):
        others = problem.subset(np.delete(np.arange(count), i))
        without = refine(others, answer.transforms).transforms
        changes[i] = _change(answer.transforms, without)
        missed, _ = linearise(problem.subset(np.array([i])), without)
        held_out[i] = np.sqrt((missed**2).sum(axis=1).mean())
    jackknife = (count - 1) / count * changes.T @ changes
    by_camera = []
    for camera in problem.camera.off_by_one_sigma():
        seen = replace(problem, pixels=camera.undistort(problem.seen_px), camera=camera)
        by_camera.append(_change(answer.transforms, refine(seen, answer.transforms).transforms))
    stacked = np.array(by_camera).reshape(-1, 6)
    from_camera = stacked.T @ stacked
    samples = larger_of(_fit_covariance(problem, answer.transforms), jackknife)
    return samples + from_camera, from_camera, held_out


def _change(one: Transforms, other: Transforms) -> Array:
    """Return (6,): rotation from one X to the other about its own axes (rad), and translation (m)."""
    turn = Rotation.from_matrix(one.x_R.T @ other.x_R).as_rotvec()
    return np.concatenate([turn, other.x_t - one.x_t])


def _fit_covariance(problem: Problem, at: Transforms) -> Array:
    """Return the covariance (6, 6) of X from the Jacobian by SVD, scaled by the larger of two variances.

    One variance is over all pixels. The other is over the residuals that a rigid motion of the target in each
    picture could explain, because a wrong robot pose causes such residuals, and all points of a picture share
    it.
    """
    missed, jacobian = linearise(problem, at)
    rows, count = jacobian.reshape(-1, 12), len(problem.ids)
    scale = np.linalg.norm(rows, axis=0)
    _, strengths, directions = np.linalg.svd(rows / scale, full_matrices=False)
    spread = directions / np.maximum(strengths, 1e-12)[:, None] / scale
    pixels = float((missed**2).sum()) / max(rows.shape[0] - 12, 1)
    rigid = 0.0
    for sample in range(count):
        mine = problem.owner == sample
        by_target = jacobian[mine].reshape(-1, 12)[:, 6:]
        q, _ = np.linalg.qr(by_target / np.maximum(np.linalg.norm(by_target, axis=0), 1e-12))
        rigid += float(((q.T @ missed[mine].reshape(-1)) ** 2).sum())
    variance = max(pixels, rigid / max(6 * count - 12, 1))
    return (spread.T @ spread)[:6, :6] * variance


def larger_of(one: Array, other: Array) -> Array:
    """Return a covariance that is the larger of two in each common principal direction; both positive.

    Directions in which one is nearly zero get a lower bound, so that the matrices can be inverted.
    """
    scale = np.sqrt(np.maximum(np.diag(one), np.diag(other)))
    scaled_one, scaled_other = one / np.outer(scale, scale), other / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled_one)
    root = vectors * np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    white = np.linalg.solve(root, np.linalg.solve(root, scaled_other).T)
    ratio, axes = np.linalg.eigh((white + white.T) / 2)
    mixed = root @ axes
    return (mixed * np.maximum(ratio, 1.0)) @ mixed.T * np.outer(scale, scale)
