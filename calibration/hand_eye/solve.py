"""Calibrate hand-eye from pictures: checks, initial values, robust refinement, outliers, next pose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.hand_eye.refine import (
    CLOSED_FORMS,
    Observability,
    Problem,
    Refined,
    Transforms,
    apply_step,
    assess_motion,
    linearise,
    nearest_rotation,
    observability,
    refine,
    uncertainty,
)
from calibration.order import Change, assess_order, find_change
from calibration.poses import REACH_M, pose_fault, repeated_pose
from calibration.targets.boards import View, on_one_line, outside, view_fault
from calibration.verdict import Assessment, Rejected, limits, rests_on, sift
from drivers.errors import CalibrationError, plural
from drivers.types import Pose

Array = NDArray[np.floating]

FEWEST_SAMPLES = 5
"""Three samples give as many equations as unknowns, and no redundancy to check them."""
_SOFT_PX = 1.0
"""Scale of the robust loss that is used to find the initial value."""
_STANDS_OUT = 3.0
"""A sample is an outlier above this multiple of the median error."""
_LEAST_OUTLIER_PX = 1.0
"""Samples with a smaller error are never rejected."""
MOST_REJECTED = 0.34
"""Largest fraction of rejected samples; above it the data contradict themselves."""
_DRAWS = 6
"""Random halves of the samples that give further initial values."""
_WORST_RMS_PX = 5.0
"""Residual above which the result is refused."""
_GOOD_RMS_PX, _GOOD_SAMPLES = 1.5, 10
"""Largest residual and fewest samples of a good calibration."""
_SIZE_MATTERS, _SIZE_STEP, _SIZE_ROUNDS = 5e-3, 1e-4, 4
"""Least deviation of a target's size that is named; step of the derivative by the size, and iterations."""
_BETTER_CAMERA = "calibrate the camera again before this, with tilted and nearer views"


class Setup(StrEnum):
    """Where the camera is mounted.

    Eye to hand: the camera is fixed, the target is on the tool; the answer is base_T_camera.
    Eye in hand: the camera is on the tool, the target is fixed; the answer is tcp_T_camera.
    """

    EYE_TO_HAND = "eye-to-hand"
    EYE_IN_HAND = "eye-in-hand"

    def arrays(self, poses: Sequence[Pose]) -> tuple[Array, Array]:
        """Return A of A Z = X B for poses `base_T_tcp`: rotations (N, 3, 3) and translations (N, 3) m."""
        return pose_arrays(poses if self is Setup.EYE_TO_HAND else [pose.inverse() for pose in poses])


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeSample:
    """One moment at rest: `base_T_tcp` from the robot, and the target in the camera's picture."""

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    view: View


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeResult:
    """The estimate and its assessment.

    pose: base_T_camera or tcp_T_camera; target: tcp_T_target or base_T_target; covariance: (6, 6) of the
    pose, rotation about its own axes (rad), translation (m); all None if refused. samples: number of used
    samples, or of blocks of pairs. From pictures: sample_px, residual by id, with the rejected samples;
    from_camera, the part of the covariance that the camera causes; held_out_px, (N,) by which the estimate
    from all other samples misses each used one; problem, refined. From pairs of poses: sigmas, (6,) estimated
    noise in the order of `USUAL_NOISE`.
    """

    setup: Setup
    assessment: Assessment
    rejected: tuple[Rejected, ...]
    motion: Observability | None = None
    pose: Pose | None = None
    target: Pose | None = None
    covariance: Array | None = None
    samples: int = 0
    used: tuple[str, ...] = ()
    sample_px: dict[str, float] | None = None
    from_camera: Array | None = None
    held_out_px: Array | None = None
    problem: Problem | None = None
    refined: Refined | None = None
    sigmas: Array | None = None


def calibrate_hand_eye(samples: Sequence[HandEyeSample], camera: CameraModel, setup: Setup) -> HandEyeResult:
    """Solve; bad data give a refused result with its reasons."""
    good, rejected = sift(samples, lambda s: s.id, lambda s, kept: _fault(s, camera, kept))
    if len(good) < FEWEST_SAMPLES:
        why = "; ".join(f"{r.id}: {r.reason}" for r in rejected[:5])
        text = f"{plural(len(good), 'usable sample')}; at least {FEWEST_SAMPLES} are needed, 15 are good"
        return HandEyeResult(setup, Assessment((text + (f" ({why})" if why else ""),)), tuple(rejected))
    problem = make_problem(good, camera, setup)
    motion = observability(problem.a_R)
    gate = assess_motion(motion)
    if gate.refusals:
        return HandEyeResult(setup, gate, tuple(rejected), motion)
    start = _robust_start(problem)
    missed = start.sample_rms_px(problem)
    bound = max(_STANDS_OUT * float(np.median(missed)), _LEAST_OUTLIER_PX)
    kept = np.flatnonzero(missed <= bound)
    outliers = np.setdiff1d(np.arange(len(problem.ids)), kept)
    sample_px = dict(zip(problem.ids, missed.tolist(), strict=True))
    if len(outliers) > MOST_REJECTED * len(problem.ids) or len(kept) < FEWEST_SAMPLES:
        reason = _contradiction(problem, start)
        return HandEyeResult(setup, Assessment((reason,)), tuple(rejected), motion, sample_px=sample_px)
    rejected += [
        Rejected(problem.ids[i], f"misses the estimate of the others by {sample_px[problem.ids[i]]:.1f} px")
        for i in outliers
    ]
    problem = problem.subset(kept)
    motion = observability(problem.a_R)
    gate = assess_motion(motion)
    final = refine(problem, start.transforms)
    if gate.refusals or final.rms_px > _WORST_RMS_PX:
        reasons = gate if gate.refusals else Assessment((_contradiction(problem, final),))
        return HandEyeResult(setup, reasons, tuple(rejected), motion, sample_px=sample_px)
    covariance, from_camera, held_out_px = uncertainty(problem, final)
    change = _find_change(problem, final)
    if change is not None:
        covariance = covariance + change.spread[:6, :6]
    sample_px |= dict(zip(problem.ids, final.sample_rms_px(problem).tolist(), strict=True))
    assessment = gate + _assess(problem, final, covariance, from_camera, len(rejected))
    assessment += assess_order(change, len(problem.ids), _PARAMETERS, _MOVED)
    return HandEyeResult(
        setup, assessment + rests_on("camera", camera.doubts), tuple(rejected), motion,
        *final.transforms.poses, covariance, len(problem.ids), problem.ids, sample_px, from_camera,
        held_out_px, problem, final,
    )  # fmt: skip


_PARAMETERS = [
    (f"the {what}'s {kind} {axis}", *unit)
    for what in ("camera", "target")
    for kind, unit in (("rotation about", (180.0 / np.pi, "deg", 0.1)), ("position along", (1e3, "mm", 1.0)))
    for axis in "xyz"
]
"""Names of the twelve parameters in messages, in the order of `linearise`."""
_MOVED = "did the camera or the target slip, or the robot get another base? Fasten both, and take all again"


def _find_change(problem: Problem, found: Refined) -> Change | None:
    """Compare samples by their order, and by the distance of the target from the camera."""
    at = found.transforms
    missed, jacobian = linearise(problem, at)
    mine = [problem.owner == i for i in range(len(problem.ids))]
    jacobians = [jacobian[rows].reshape(-1, 12) for rows in mine]
    away_m = np.linalg.norm(problem.a_R @ at.z_t + problem.a_t - at.x_t, axis=1)
    return find_change(
        problem.ids, jacobians, [-missed[rows].reshape(-1) for rows in mine], {"distance": away_m}
    )


def _assess(
    problem: Problem, final: Refined, covariance: Array, from_camera: Array, rejected: int
) -> Assessment:
    """Assess an estimate; the reason for a sigma names the camera if it causes most of the variance.

    A target of another size than given is named if the size explains more than half of the residual.
    """
    samples, size = len(problem.ids), _fit_size(problem, final)
    named = abs(size[0] - 1.0) > _SIZE_MATTERS and size[1].rms_px ** 2 < 0.5 * final.rms_px**2
    residual = "residual of the samples {value:.2f} px: "
    cause = (
        _other_size(size[0])
        if named
        else "is the target rigidly mounted, the robot at rest, the camera right?"
    )
    sigma, camera_sigma = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(from_camera))
    mm, camera_mm = (float(np.linalg.norm(1e3 * of[3:])) for of in (sigma, camera_sigma))
    deg, camera_deg = (float(np.linalg.norm(np.degrees(of[:3]))) for of in (sigma, camera_sigma))
    by_camera = f" of it from the camera's intrinsics: {_BETTER_CAMERA}"
    more = f", {camera_mm:.2f}{by_camera}" if 2 * camera_mm**2 > mm**2 else ": add samples"
    larger = ": add samples with larger rotations"
    larger = f", {camera_deg:.3f}{by_camera}" if 2 * camera_deg**2 > deg**2 else larger
    return limits(
        (final.rms_px, 0.0 if named else _GOOD_RMS_PX, _WORST_RMS_PX, residual + cause),
        (mm, 1.0, 50.0, "position known only to {value:.2f} mm" + more),
        (deg, 0.1, 5.0, "orientation known only to {value:.3f} degrees" + larger),
        (samples, _GOOD_SAMPLES, FEWEST_SAMPLES, f"{plural(samples, 'sample')} used; 15 are good"),
        (rejected, 0.15 * (samples + rejected), np.inf, f"{plural(rejected, 'sample')} left out; see why"),
    )  # fmt: skip


def _fit_size(problem: Problem, found: Refined) -> tuple[float, Refined]:
    """Fit the target's size, as a factor of the given one, which the robot's motion gives; and the fit."""
    size, fit = 1.0, found
    for _ in range(_SIZE_ROUNDS):
        missed, jacobian = linearise(_of_size(problem, size), fit.transforms)
        larger, _ = linearise(_of_size(problem, size + _SIZE_STEP), fit.transforms)
        system = np.column_stack([jacobian.reshape(-1, 12), ((larger - missed) / _SIZE_STEP).reshape(-1)])
        scale = np.maximum(np.linalg.norm(system, axis=0), 1e-12)
        step = np.linalg.lstsq(system / scale, -missed.reshape(-1), rcond=None)[0] / scale
        size = float(np.clip(size + step[12], 0.3 * size, 3.0 * size))
        fit = refine(_of_size(problem, size), apply_step(fit.transforms, step[:12]))
    return size, fit


def _of_size(problem: Problem, size: float) -> Problem:
    return replace(problem, points_m=size * problem.points_m)


def _other_size(size: float) -> str:
    return f"the robot's motions fit a target of {size:.3f} times the given size: measure its print"


def _robust_start(problem: Problem) -> Refined:
    """Return the best of several initial values after robust refinement on pixels.

    Initial values are closed forms over all samples, again with the flat target's ambiguous poses chosen
    consistently, and over random halves (fixed seed), so that a few wrong samples cannot affect all of them.
    """
    turns, moves = target_poses(problem)
    everyone = np.arange(len(problem.ids))
    rng = np.random.default_rng(0)
    half = max(4, len(everyone) // 2)
    subsets = [everyone, *(np.sort(rng.choice(everyone, half, replace=False)) for _ in range(_DRAWS))]
    best: Refined | None = None
    for number, subset in enumerate(subsets):
        for name in CLOSED_FORMS if number == 0 else ("shah",):
            found = refine(problem, _solve_closed_form(name, problem, subset, turns, moves), _SOFT_PX)
            t = found.transforms
            finite = np.isfinite(found.cost) and np.isfinite(t.x_t).all() and np.isfinite(t.x_R).all()
            if finite and (best is None or found.cost < best.cost * (1 - 1e-6)):
                best = found
    if best is None:  # all poses are finite, so this is a bug and not bad input
        raise ArithmeticError("hand-eye: no initial value led to a finite estimate")
    return best


def _contradiction(problem: Problem, found: Refined) -> str:
    """Report that the samples contradict one another, and a simple mistake that would explain it."""
    now = float(np.median(found.sample_rms_px(problem)))
    seen = f"the samples contradict one another (median residual {now:.0f} px)"
    size, fit = _fit_size(problem, found)
    if float(np.median(fit.sample_rms_px(problem))) < 0.2 * now:
        return f"{seen}: {_other_size(size)}"
    a_R, a_t = problem.a_R, problem.a_t  # noqa: N806
    back = a_R.transpose(0, 2, 1)
    inverted = "the robot poses look inverted (tcp_T_base for base_T_tcp, or the other setup)"
    tries: list[tuple[str, Array, Array]] = [(inverted, back, -(back @ a_t[..., None])[..., 0])]
    for offset, by in (("one", 1), ("minus one", -1)):
        text = f"pictures and poses look paired with an offset of {offset}"
        tries.append((text, np.roll(a_R, by, axis=0), np.roll(a_t, by, axis=0)))
    for text, turns, moves in tries:
        other = replace(problem, a_R=turns, a_t=moves)
        if float(np.median(_robust_start(other).sample_rms_px(other))) < 0.2 * now:
            return f"{seen}: {text}"
    return f"{seen}: check the pairing, the pose convention, and that target and robot are at rest"


def _solve_closed_form(
    name: str, problem: Problem, subset: NDArray[np.int64], turns: Array, moves: Array
) -> Transforms:
    """Return a closed form, recomputed with each target pose chosen to agree with it."""
    rows = np.arange(len(subset))
    choice = np.zeros(len(subset), np.int64)
    a_R, a_t = problem.a_R[subset], problem.a_t[subset]  # noqa: N806
    answer = None
    for _ in range(3):
        b_R, b_t = turns[subset][rows, choice], moves[subset][rows, choice]  # noqa: N806
        answer = CLOSED_FORMS[name](a_R, a_t, b_R, b_t)
        expected = answer.x_R.T @ a_R @ answer.z_R
        again = np.argmax(np.einsum("nkij,nij->nk", turns[subset], expected), axis=1)
        if (again == choice).all():
            break
        choice = again
    if answer is None or not np.isfinite(answer.x_t).all():
        return Transforms(nearest_rotation(np.eye(3)), np.zeros(3), np.eye(3), np.zeros(3))
    return answer


_BORDER_PX = 10.0
"""Corners nearer to the border count as outside the picture."""
_LARGEST_TILT = np.cos(np.radians(60.0))
"""Cosine of the largest angle between the target's normal and the line of sight."""
_LEVER_M = 0.3
"""A rotation counts as the displacement that it causes at this distance from the camera."""


def next_pose(
    result: HandEyeResult, camera: CameraModel, candidates: Sequence[Pose]
) -> tuple[float, int] | None:
    """Choose among reachable `base_T_tcp`; None if no candidate shows the target to the camera.

    Returns the predicted one sigma (m, at 0.3 m from the camera) after adding the candidate, and its index.
    Raises `CalibrationError` if there is no first estimate yet.
    """
    if result.problem is None or result.refined is None or result.pose is None or result.target is None:
        raise CalibrationError(
            "hand-eye: no estimate yet to improve; visit poses rotated by 30 degrees about two axes"
        )
    camera_T_base_or_tcp, at = result.pose.inverse(), result.refined.transforms  # noqa: N806
    points = np.unique(result.problem.points_m, axis=0)
    known = _information(result.problem, at)
    noise = max(result.refined.rms_px / np.sqrt(2.0), 0.05)
    predicted: list[tuple[float, int]] = []
    for index, pose in enumerate(candidates):
        robot = pose if result.setup is Setup.EYE_TO_HAND else pose.inverse()
        camera_T_target = camera_T_base_or_tcp @ robot @ result.target  # noqa: N806
        in_camera = camera_T_target.rotation.apply(points) + np.asarray(camera_T_target.position_m)
        sight = np.asarray(camera_T_target.position_m) / np.linalg.norm(camera_T_target.position_m)
        facing = abs(float(camera_T_target.rotation.as_matrix()[:, 2] @ sight))
        if in_camera[:, 2].min() < 0.05 or facing < _LARGEST_TILT:
            continue
        pixels = camera.project(in_camera)
        if not ((pixels > _BORDER_PX) & (pixels < np.subtract(camera.size, 1 + _BORDER_PX))).all():
            continue
        view = View("next", np.arange(len(points)), points, pixels, camera.size)
        seen = make_problem([HandEyeSample("next", pose, view)], camera, result.setup)
        information = known + _information(seen, at)
        scale = np.sqrt(np.diag(information))
        scales = np.outer(scale, scale)
        variances = np.diag(np.linalg.pinv(information / scales, hermitian=True) / scales)
        sigma_m = float(noise * np.sqrt(variances[3:6].sum() + _LEVER_M**2 * variances[:3].sum()))
        predicted.append((sigma_m, index))
    return min(predicted, default=None)


def _information(problem: Problem, at: Transforms) -> Array:
    """Return the information matrix (12, 12) of X and Z: J^T J, in px^-2."""
    _, jacobian = linearise(problem, at)
    rows = jacobian.reshape(-1, 12)
    return rows.T @ rows


def pose_arrays(poses: Sequence[Pose]) -> tuple[Array, Array]:
    """Return rotation matrices (N, 3, 3) and positions (N, 3) m."""
    return np.array([p.rotation.as_matrix() for p in poses]), np.array([p.position_m for p in poses])


def make_problem(samples: Sequence[HandEyeSample], camera: CameraModel, setup: Setup) -> Problem:
    a_R, a_t = setup.arrays([s.base_T_tcp for s in samples])  # noqa: N806
    seen = np.vstack([s.view.image_px for s in samples])
    return Problem(
        ids=tuple(s.id for s in samples),
        a_R=a_R,
        a_t=a_t,
        points_m=np.vstack([s.view.board_m for s in samples]),
        seen_px=seen,
        pixels=camera.undistort(seen),
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


def _fault(sample: HandEyeSample, camera: CameraModel, others: list[HandEyeSample]) -> str | None:
    """Return why a sample cannot be used, or None; others: the accepted ones.

    A repeated pose adds no information, and makes leave-one-out meaningless.
    """
    view = sample.view
    few = f"{plural(len(view.ids), 'point')} of the target seen, at least 4 are needed"
    resized = f"picture of {view.size} px, the camera was calibrated at {camera.size}"
    reason = view_fault(view, 4, few, camera.size, resized) or outside(view)
    if reason is None and on_one_line(view.image_px):
        reason = "all points seen lie on one line"
    reason = reason or pose_fault(sample.base_T_tcp, "robot pose", REACH_M)
    if reason is None and any(other.id == sample.id for other in others):
        reason = f"a second sample with the id {sample.id}"
    return reason or repeated_pose(sample.base_T_tcp, ((other.id, other.base_T_tcp) for other in others))
