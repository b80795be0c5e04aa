"""Hand-eye calibration from pairs of robot pose and target pose from a detector, instead of pixels.

A detector measures a target's position well across the view, but badly in depth and tilt. A rotation error of
the robot displaces a distant target by much. Which of both dominates differs between data sets by a factor of
a hundred. So six standard deviations of robot and detector are estimated from the residuals (restricted
maximum likelihood of Gaussian residuals), with a wide prior that matters only for few poses.

If pictures are available, `solve.calibrate_hand_eye` fits their pixels and is several times as accurate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from calibration.hand_eye.refine import (
    CLOSED_FORMS,
    Transforms,
    apply_step,
    assess_motion,
    cross_matrices,
    larger_of,
    motions,
    observability,
)
from calibration.hand_eye.solve import FEWEST_SAMPLES, MOST_REJECTED, HandEyeResult, Setup, pose_arrays
from calibration.poses import REACH_M, pose_fault, repeated_pose
from calibration.verdict import Assessment, Rejected, limits, sift
from drivers.errors import plural
from drivers.types import Pose

Array = NDArray[np.floating]

USUAL_NOISE = np.array([np.radians(0.03), 3e-4, np.radians(0.2), np.radians(0.2), 1e-3, 3e-3])
"""Robot: rotation (rad), position (m). Detector: tilt, rotation about the axis (rad), across, depth (m)."""
_WIDE = np.array([1.2, 1.2, 2.5, 2.5, 2.5, 2.5])
"""One sigma of the prior of each logarithm."""
_LEAST, _MOST = 1e-3, 1e3
"""Limits of the estimated noise, as multiples of `USUAL_NOISE`."""
_TAIL = 5.0
"""Degrees of freedom of Student's t: pairs with a large residual get less weight."""
_OUTLIER = 35.0
"""Squared whitened distance (6 values) above which a pair is an outlier; 4 in a million good pairs exceed
it."""
_ROUNDS, _NOISE_ROUNDS = 40, 12
"""Most iterations of the least-squares fit, and of the noise estimate."""
_MOST_PAIRS = 200
"""Longer series are thinned to this many pairs."""
_FOR_STARTS = 40
"""Number of pairs for the search of initial values."""
_DRAWS, _DRAWN, _TRIED = 20, 6, 6
"""Random subsets for initial values: their number, their size, and Gauss-Newton rounds for each."""
_BLOCKS = 20
"""Most blocks of the jackknife."""
_SIZE_MATTERS, _FAR_MORE = 5e-3, 10.0
"""A wrong target size is reported if it changes distances by this fraction and gains this log likelihood."""
_FIRST_GUESS = 3.0
"""Initial noise during the search, as a multiple of the usual noise."""


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One moment: `base_T_tcp` from the robot, and `camera_T_target` from a detector."""

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    camera_T_target: Pose  # noqa: N815


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """The samples as arrays. Both setups satisfy A_i Z = X B_i, as in `refine.Problem`.

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


def _fault(sample: PoseSample, others: list[PoseSample]) -> str | None:
    """Return why a sample cannot be used, or None. others: the samples accepted so far."""
    if any(other.id == sample.id for other in others[-1:]):
        return f"a second sample with the id {sample.id}"
    return pose_fault(sample.base_T_tcp, "robot pose", REACH_M) or pose_fault(
        sample.camera_T_target, "target's pose"
    )


def pair_residuals(pairs: PosePairs, at: Transforms) -> tuple[Array, Array]:
    """Return residuals (N, 6) and their derivatives (N, 6, 12).

    A residual is the rotation (rad) and displacement (m) from the measured to the predicted target, in camera
    axes. Columns as in `refine.linearise`: rotation and translation of X, then of Z.
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


def fit_noise(parts: Array, residuals: Array, weights: Array, parameters: int, start: Array) -> Array:
    """Return the (6,) standard deviations that explain (N, 6) residuals best, with (N,) weights.

    parts: from `noise_parts`. parameters: number fitted to the residuals, which made the residuals smaller.
    start: initial standard deviations.
    """
    count = residuals.size
    quadratic = weights * count / max(count - parameters, 1)

    def cost(logs: Array) -> tuple[float, Array]:
        sigmas = USUAL_NOISE * np.exp(logs)
        combined = np.einsum("k,knij->nij", sigmas**2, parts)
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


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Transforms with residuals (N, 6), derivatives (N, 6, 12), and inverse covariances (N, 6, 6).

    distance: (N,) squared, whitened.
    """

    at: Transforms
    missed: Array
    by_step: Array
    inverse: Array
    distance: Array

    @property
    def weights(self) -> Array:
        return (_TAIL + 6.0) / (_TAIL + self.distance)

    def normal(self, rows: NDArray[np.int64] | slice = slice(None)) -> tuple[Array, Array]:
        """Return the normal equations (12, 12) and (12,) of these pairs."""
        weighted = self.weights[rows, None, None] * self.inverse[rows]
        left = self.by_step[rows].transpose(0, 2, 1) @ weighted
        return (left @ self.by_step[rows]).sum(axis=0), (left @ self.missed[rows, :, None]).sum(axis=0)[:, 0]

    def step(self, rows: NDArray[np.int64] | slice = slice(None)) -> Array:
        matrix, target = self.normal(rows)
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        return -np.linalg.lstsq(matrix / np.outer(scale, scale), target / scale, rcond=1e-13)[0] / scale


def calibrate_pose_pairs(samples: Sequence[PoseSample], setup: Setup) -> HandEyeResult:
    """Solve; bad data give a refused result with its reasons.

    samples: in order of time, because neighbouring samples of a stream share errors, which is detected.
    """
    usable, rejected = sift(samples, lambda s: s.id, _fault)
    chosen = [usable[i] for i in _spread_indices(len(usable), _MOST_PAIRS)]
    good, repeated = sift(
        chosen, lambda s: s.id,
        lambda s, kept: repeated_pose(s.base_T_tcp, ((other.id, other.base_T_tcp) for other in kept)),
    )  # fmt: skip
    rejected += repeated
    if len(good) < FEWEST_SAMPLES:
        text = f"{plural(len(good), 'usable pair')}; at least {FEWEST_SAMPLES} are needed, 15 are good"
        return HandEyeResult(setup, Assessment((text,)), tuple(rejected))
    robot, seen = setup.arrays([s.base_T_tcp for s in good]), pose_arrays([s.camera_T_target for s in good])
    pairs = PosePairs(tuple(s.id for s in good), *robot, *seen, setup)
    motion = observability(pairs.subset(_spread_indices(len(pairs.ids), _FOR_STARTS)).a_R)
    gate = assess_motion(motion)
    if gate.refusals:
        return HandEyeResult(setup, gate, tuple(rejected), motion)
    kept, fit, sigmas = _robust(pairs, _best_start(pairs))
    count = len(pairs.ids)
    refusal = _wrong_size(pairs, fit.at, sigmas)
    if refusal is None and len(kept) < max((1.0 - MOST_REJECTED) * count, FEWEST_SAMPLES):
        refusal = (
            f"{count - len(kept)} of {count} pairs contradict the others: check the pairing, the pose "
            "convention (inverted? quaternion order?), that the target is rigidly mounted, and its size"
        )
    if refusal is not None:
        return HandEyeResult(setup, Assessment((refusal,)), tuple(rejected), motion)
    out = np.setdiff1d(np.arange(count), kept)
    rejected += [Rejected(pairs.ids[i], "contradicts the other pairs") for i in out]
    # alike: the largest of six correlations of neighbours' whitened errors; 0 if it is not significant
    white = (np.linalg.cholesky(fit.inverse).transpose(0, 2, 1) @ fit.missed[..., None])[..., 0]
    found = float(((white[1:] * white[:-1]).sum(axis=0) / np.maximum((white**2).sum(axis=0), 1e-300)).max())
    alike = found if found > 3.5 / np.sqrt(len(white)) else 0.0
    covariance, blocks = _spread(fit, alike)
    sigma = np.sqrt(np.diag(covariance))
    mm, deg = 1e3 * float(np.linalg.norm(sigma[3:])), float(np.degrees(np.linalg.norm(sigma[:3])))
    hint = "add pairs with larger rotations about two axes, or calibrate from pictures"
    assessment = limits(
        (mm, 2.0, 50.0, "position known to {value:.1f} mm only: " + hint),
        (deg, 0.2, 5.0, "orientation known to {value:.2f} degrees only: " + hint),
        (blocks, 10, FEWEST_SAMPLES, f"{plural(blocks, 'pair')} used; 15 are good"),
        (len(out), 0.15 * count, np.inf, f"{plural(len(out), 'pair')} left out; see why"),
        (alike, 0.3, np.inf,
         "errors of neighbouring pairs are correlated ({value:.2f}; noise: 0), which raises sigma: does the "
         "robot's model, the clock or the detector's scale drift?",
         "correlation of the errors of neighbouring pairs: {value:.2f}"),
    )  # fmt: skip
    if float(np.median(pairs.b_t[:, 2])) < 0.0:
        text = "the target is behind the camera: camera_T_target needs axes as OpenCV's, z forward and y down"
        assessment += Assessment(doubts=(text,))
    return HandEyeResult(
        setup, gate + assessment, tuple(rejected), motion, *fit.at.poses, covariance, blocks,
        tuple(pairs.ids[i] for i in kept), sigmas=sigmas,
    )  # fmt: skip


def _spread_indices(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` indices of `count`, evenly spaced."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _wrong_size(pairs: PosePairs, at: Transforms, sigmas: Array) -> str | None:
    """Return that the distances fit another target size, if that explains the data much better; or None."""
    # distances are too long by a factor, in which the problem of motions between all pairs is linear, as in
    # X's position, after X's rotation is known (Andreff et al. 2001)
    some = pairs.subset(_spread_indices(len(pairs.ids), _FOR_STARTS))
    turns, moves = motions(some.a_R, some.a_t)
    _, seen = motions(some.b_R, some.b_t)
    system = np.concatenate([turns - np.eye(3), -(seen @ at.x_R.T)[..., None]], axis=2).reshape(-1, 4)
    answer, *_ = np.linalg.lstsq(system, -moves.reshape(-1), rcond=None)
    scale = 1.0 / float(answer[3]) if abs(answer[3]) > 1e-9 else np.inf
    if not 0.02 < scale < 50.0 or abs(scale - 1.0) < _SIZE_MATTERS:
        return None
    scaled = replace(pairs, b_t=pairs.b_t / scale)
    _, fit, noise = _robust(scaled, _best_start(scaled))
    if _surprise(pairs, at, sigmas) - _surprise(scaled, fit.at, noise) < _FAR_MORE:
        return None
    return (
        f"the target's distances look {scale:.3f} times as long as the robot's motions: is its size right, "
        "and are both in m?"
    )


def _surprise(pairs: PosePairs, at: Transforms, sigmas: Array) -> float:
    """Return the negative log likelihood of all pairs under Student's t, up to a constant."""
    fit = _at(pairs, at, sigmas)
    tails = 0.5 * (_TAIL + 6.0) * np.log1p(fit.distance / _TAIL)
    return float((tails - 0.5 * np.linalg.slogdet(fit.inverse)[1]).sum())


def _fit(pairs: PosePairs, at: Transforms, sigmas: Array, rounds: int = _ROUNDS) -> _Fit:
    """Gauss-Newton with Student's t weights at the given noise."""
    for _ in range(rounds):
        now = _at(pairs, at, sigmas)
        step = now.step()
        size = float(np.abs(step).max())
        at = apply_step(at, step * min(1.0, 0.5 / max(size, 1e-12)))
        if size < 1e-9:
            break
    return _at(pairs, at, sigmas)


def _at(pairs: PosePairs, at: Transforms, sigmas: Array) -> _Fit:
    missed, by_step = pair_residuals(pairs, at)
    inverse = np.linalg.inv(np.einsum("k,knij->nij", sigmas**2, noise_parts(by_robot(pairs, at))))
    return _Fit(at, missed, by_step, inverse, np.einsum("ni,nij,nj->n", missed, inverse, missed))


def _best_start(pairs: PosePairs) -> Transforms:
    """Return the best of closed forms over all pairs and random subsets (fixed seed), fitted robustly."""
    some = pairs.subset(_spread_indices(len(pairs.ids), _FOR_STARTS))
    everyone, rng = np.arange(len(some.ids)), np.random.default_rng(0)
    tries = [(name, everyone) for name in CLOSED_FORMS]
    if len(everyone) > _DRAWN:
        tries += [("shah", np.sort(rng.choice(everyone, _DRAWN, replace=False))) for _ in range(_DRAWS)]
    best: tuple[float, Transforms] | None = None
    for name, rows in tries:
        part = some.subset(rows)
        start = CLOSED_FORMS[name](part.a_R, part.a_t, part.b_R, part.b_t)
        if not np.isfinite(start.x_t).all():
            continue
        fit = _fit(some, start, _FIRST_GUESS * USUAL_NOISE, _TRIED)
        cost = float(np.log1p(fit.distance / _TAIL).sum())
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = cost, fit.at
    if best is None:  # all poses are finite, so this is a bug and not bad input
        raise ArithmeticError("hand-eye: no initial value led to a finite estimate")
    return best[1]


def _robust(pairs: PosePairs, start: Transforms) -> tuple[NDArray[np.int64], _Fit, Array]:
    """Return consistent pairs, their fit, and the (6,) estimated noise; outliers may return later."""
    everyone = np.arange(len(pairs.ids))
    at, sigmas, kept = start, _FIRST_GUESS * USUAL_NOISE, everyone
    for _ in range(_NOISE_ROUNDS):
        used = pairs.subset(kept)
        fit = _fit(used, at, sigmas, 8)
        found = fit_noise(noise_parts(by_robot(used, fit.at)), fit.missed, fit.weights, 12, sigmas)
        at, change, sigmas = fit.at, float(np.abs(np.log(found / sigmas)).max()), found
        again = everyone[_at(pairs, at, sigmas).distance <= _OUTLIER]
        if change < 0.02 and np.array_equal(again, kept):
            break
        if len(again) < FEWEST_SAMPLES:
            return again, fit, sigmas
        kept = again
    return kept, _fit(pairs.subset(kept), at, sigmas), sigmas


def _spread(fit: _Fit, alike: float) -> tuple[Array, int]:
    """Return the covariance (6, 6) of X, the larger of fit and block jackknife, and the number of blocks.

    If neighbours' errors are correlated, the effective number of pairs is smaller.
    """
    count, widened = len(fit.missed), (1.0 + alike) / max(1.0 - alike, 0.02)
    model = np.linalg.inv(fit.normal()[0]) * fit.missed.size / max(fit.missed.size - 12, 1) * widened
    blocks = np.array_split(np.arange(count), min(count, _BLOCKS))
    changes = np.array([fit.step(np.setdiff1d(np.arange(count), block)) for block in blocks])
    jackknife = (len(blocks) - 1) / len(blocks) * changes.T @ changes
    return larger_of(model[:6, :6], jackknife[:6, :6]), len(blocks)
