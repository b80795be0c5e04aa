"""Hand-eye calibration from pairs of poses: checks, robust initial values, noise estimate, outlier rejection.

If pictures are available, `solve.calibrate_hand_eye` fits their pixels and is several times as accurate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.closed_form import (
    CLOSED_FORMS,
    Transforms,
    assess_motion,
    motions,
    observability,
)
from calibration.hand_eye.pose_pairs import (
    USUAL_NOISE,
    PosePairs,
    PoseSample,
    by_robot,
    covariances,
    fit_noise,
    make_pairs,
    noise_parts,
    pair_residuals,
    repeated_pair,
    sample_fault,
)
from calibration.hand_eye.refine import larger_of, moved
from calibration.hand_eye.samples import Setup
from calibration.hand_eye.solve import FEWEST_SAMPLES, HandEyeResult, as_pose
from calibration.verdict import Assessment, Rejected, floor, limit, sift
from drivers.errors import counted

Array = NDArray[np.floating]

_TAIL = 5.0
"""Degrees of freedom of Student's t: pairs with a large residual get less weight."""
_OUTLIER = 35.0
"""Squared whitened distance (6 values) above which a pair is an outlier; 4 in a million good pairs exceed
it."""
_MOST_REJECTED = 0.34
"""Largest fraction of rejected pairs; above it the data contradict themselves."""
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
        """Return the (12,) Gauss-Newton step of these pairs."""
        matrix, target = self.normal(rows)
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        return -np.linalg.lstsq(matrix / np.outer(scale, scale), target / scale, rcond=1e-13)[0] / scale


def calibrate_pose_pairs(samples: Sequence[PoseSample], setup: Setup) -> HandEyeResult:
    """Solve; bad data give a refused result with its reasons.

    samples: in order of time, because neighbouring samples of a stream share errors, which is detected.
    """
    usable, rejected = sift(samples, lambda s: s.id, sample_fault)
    chosen = [usable[i] for i in _spaced(len(usable), _MOST_PAIRS)]
    good, repeated = sift(chosen, lambda s: s.id, repeated_pair)
    rejected += repeated
    if len(good) < FEWEST_SAMPLES:
        text = f"{counted(len(good), 'usable pair')}; at least {FEWEST_SAMPLES} are needed, 15 are good"
        return HandEyeResult(setup, Assessment((text,)), tuple(rejected))
    pairs = make_pairs(good, setup)
    motion = observability(thinned(pairs, _FOR_STARTS).a_R)
    gate = assess_motion(motion)
    if gate.refusals:
        return HandEyeResult(setup, gate, tuple(rejected), motion)
    kept, fit, sigmas = _robust(pairs, _best_start(pairs))
    refusal = _wrong_size(pairs, fit.at, sigmas) or _contradiction(pairs, len(kept))
    if refusal is not None:
        return HandEyeResult(setup, Assessment((refusal,)), tuple(rejected), motion)
    out = np.setdiff1d(np.arange(len(pairs.ids)), kept)
    rejected += [Rejected(pairs.ids[i], "contradicts the other pairs") for i in out]
    # alike: the largest of six correlations of neighbours' whitened errors; 0 if it is not significant
    white = (np.linalg.cholesky(fit.inverse).transpose(0, 2, 1) @ fit.missed[..., None])[..., 0]
    found = float(((white[1:] * white[:-1]).sum(axis=0) / np.maximum((white**2).sum(axis=0), 1e-300)).max())
    alike = found if found > 3.5 / np.sqrt(len(white)) else 0.0
    covariance, count = _spread(fit, alike)
    return HandEyeResult(
        setup, gate + _assess(covariance, count, len(out), len(pairs.ids), alike), tuple(rejected), motion,
        as_pose(fit.at.x_R, fit.at.x_t), as_pose(fit.at.z_R, fit.at.z_t), covariance=covariance,
        sigmas=sigmas, samples=count, used=tuple(pairs.ids[i] for i in kept),
    )  # fmt: skip


def _assess(covariance: Array, count: int, left_out: int, pairs: int, alike: float) -> Assessment:
    sigma = np.sqrt(np.diag(covariance))
    mm, deg = 1e3 * float(np.linalg.norm(sigma[3:])), float(np.degrees(np.linalg.norm(sigma[:3])))
    hint = "add pairs with larger rotations about two axes, or calibrate from pictures"
    return (
        limit(mm, 2.0, 50.0, "position known to {value:.1f} mm only: " + hint)
        + limit(deg, 0.2, 5.0, "orientation known to {value:.2f} degrees only: " + hint)
        + floor(count, 10, FEWEST_SAMPLES, f"{counted(count, 'pair')} used; 15 are good")
        + limit(left_out, 0.15 * pairs, np.inf, f"{counted(left_out, 'pair')} left out; see why")
        + limit(
            alike, 0.3, np.inf,
            "errors of neighbouring pairs are correlated ({value:.2f}; noise: 0), which raises sigma: does "
            "the robot's model, the clock or the detector's scale drift?",
            "correlation of the errors of neighbouring pairs: {value:.2f}",
        )
    )  # fmt: skip


def thinned(pairs: PosePairs, most: int) -> PosePairs:
    """Return at most `most` pairs, evenly spaced."""
    return pairs.subset(_spaced(len(pairs.ids), most))


def _spaced(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` indices of `count`, evenly spaced."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _contradiction(pairs: PosePairs, kept: int) -> str | None:
    count = len(pairs.ids)
    if kept >= max((1.0 - _MOST_REJECTED) * count, FEWEST_SAMPLES):
        return None
    return (
        f"{count - kept} of {count} pairs contradict the others: check the pairing, the pose convention "
        "(inverted? quaternion order?), that the target is rigidly mounted, and its size"
    )


def _wrong_size(pairs: PosePairs, at: Transforms, sigmas: Array) -> str | None:
    """Return that the distances fit another target size, if that explains the data much better; or None."""
    scale = _distance_scale(thinned(pairs, _FOR_STARTS), at)
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


def _distance_scale(pairs: PosePairs, at: Transforms) -> float:
    """Return the factor by which distances to the target are too long, from motions between all pairs.

    The problem is linear in that factor and X's position after its rotation is known (Andreff et al. 2001).
    """
    turns, moves = motions(pairs.a_R, pairs.a_t)
    _, seen = motions(pairs.b_R, pairs.b_t)
    system = np.concatenate([turns - np.eye(3), -(seen @ at.x_R.T)[..., None]], axis=2).reshape(-1, 4)
    answer, *_ = np.linalg.lstsq(system, -moves.reshape(-1), rcond=None)
    return 1.0 / float(answer[3]) if abs(answer[3]) > 1e-9 else np.inf


def _fit(pairs: PosePairs, at: Transforms, sigmas: Array, rounds: int = _ROUNDS) -> _Fit:
    """Gauss-Newton with Student's t weights at the given noise."""
    for _ in range(rounds):
        now = _at(pairs, at, sigmas)
        step = now.step()
        size = float(np.abs(step).max())
        at = moved(at, step * min(1.0, 0.5 / max(size, 1e-12)))
        if size < 1e-9:
            break
    return _at(pairs, at, sigmas)


def _at(pairs: PosePairs, at: Transforms, sigmas: Array) -> _Fit:
    missed, by_step = pair_residuals(pairs, at)
    inverse = np.linalg.inv(covariances(noise_parts(by_robot(pairs, at)), sigmas))
    return _Fit(at, missed, by_step, inverse, np.einsum("ni,nij,nj->n", missed, inverse, missed))


def _best_start(pairs: PosePairs) -> Transforms:
    """Return the best of closed forms over all pairs and random subsets (fixed seed), fitted robustly."""
    some = thinned(pairs, _FOR_STARTS)
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
