"""Hand-eye from pictures and from pairs of poses: accuracy, sigma, and refusals of undetermined motions."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.hand_eye.pose_pairs import PoseSample, calibrate_pose_pairs
from calibration.hand_eye.refine import park, shah
from calibration.hand_eye.solve import (
    HandEyeResult,
    HandEyeSample,
    Setup,
    calibrate_hand_eye,
    make_problem,
    next_pose,
    target_poses,
)
from calibration.poses import pose_fault, pose_from_matrix, pose_from_quaternion, pose_from_rotation_vector
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from drivers.types import Pose
from support.marks import heavy
from support.motions import CAMERA, ORDERS, Truth, general_scene, jittered, motion_scene, pose_pairs
from support.units import IN_MM, units

Random = np.random.Generator
Scene = tuple[Truth, list[HandEyeSample]]
every_setup = pytest.mark.parametrize("setup", list(Setup))
FEW = ("rows at random", "first row forty times")
every_order = pytest.mark.parametrize(
    "order",
    [*(ORDERS[name] for name in FEW), *heavy(*(of for name, of in ORDERS.items() if name not in FEW))],
)


def solved(
    samples: list[HandEyeSample], setup: Setup = Setup.EYE_TO_HAND, camera: CameraModel = CAMERA
) -> HandEyeResult:
    return calibrate_hand_eye(samples, camera, setup)


def paired(pairs: list[PoseSample], setup: Setup = Setup.EYE_TO_HAND) -> HandEyeResult:
    return calibrate_pose_pairs(pairs, setup)


def holds(result: HandEyeResult, truth: Truth) -> bool:
    """Return whether the truth lies within the 95 % confidence region (F test)."""
    assert result.pose is not None, result.assessment
    assert result.covariance is not None
    error = truth.error_vector(result.pose)
    bound = 6 * f_distribution.ppf(0.95, 6, max(result.samples - 1, 1))
    return float(error @ np.linalg.solve(result.covariance, error)) <= bound


def error_mm(result: HandEyeResult, truth: Truth) -> float:
    assert result.pose is not None, result.assessment
    return truth.error(result.pose)[0]


def test_closed_forms_equal_those_of_opencv() -> None:
    for seed in (3, 4):
        _, samples = general_scene(np.random.default_rng(seed), 12)
        problem = make_problem(samples, CAMERA, Setup.EYE_TO_HAND)
        turns, moves = target_poses(problem)
        a_R, a_t, b_R, b_t = problem.a_R, problem.a_t, turns[:, 0], moves[:, 0]  # noqa: N806
        inverse = a_R.transpose(0, 2, 1)
        back = -(inverse @ a_t[..., None])
        turn, move = cv2.calibrateHandEye(
            list(inverse), list(back), list(b_R), list(b_t[..., None]), method=cv2.CALIB_HAND_EYE_PARK
        )
        ours = park(a_R, a_t, b_R, b_t)
        assert ours.x_R == pytest.approx(turn, abs=1e-9)
        assert ours.x_t == pytest.approx(move.ravel(), abs=1e-9)
        both = cv2.calibrateRobotWorldHandEye(
            list(a_R), list(a_t[..., None]), list(b_R), list(b_t[..., None]),
            method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
        )  # fmt: skip
        other = shah(a_R, a_t, b_R, b_t)
        for mine, its in zip((other.z_R, other.z_t, other.x_R, other.x_t), both, strict=True):
            assert mine.ravel() == pytest.approx(its.ravel(), abs=1e-6)
        assert ours.z_t == pytest.approx(other.z_t, abs=1e-2)


@every_setup
def test_exact_pairs_give_the_exact_transform(setup: Setup) -> None:
    truth, samples = pose_pairs(0, 12, setup, noise=0.0)
    result = paired(samples, setup)
    assert result.pose is not None
    assert result.target is not None
    assert truth.error(result.pose) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert np.allclose(result.target.position_m, truth.z.position_m, atol=1e-6)


@pytest.mark.heavy
def test_target_behind_the_camera_is_doubted() -> None:
    _, samples = pose_pairs(0, 20, Setup.EYE_TO_HAND)
    assert "behind the camera" not in str(paired(samples).assessment)
    half_turn = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))  # about x, from OpenCV's axes to OpenGL's
    turned = [replace(s, camera_T_target=half_turn @ s.camera_T_target) for s in samples]
    assert "axes as OpenCV's, z forward" in str(paired(turned).assessment)


def test_flipped_samples_are_left_out_and_named() -> None:
    truth, samples = general_scene(np.random.default_rng(2), 20, flipped=2)
    result = solved(samples)
    assert {r.id for r in result.rejected} == {"00", "01"}
    assert error_mm(result, truth) < 1.0


@pytest.mark.heavy
def test_samples_of_which_more_than_a_third_are_flipped_are_refused() -> None:
    _, samples = general_scene(np.random.default_rng(2), 20, flipped=8)
    result = solved(samples)
    assert result.pose is None
    assert "contradict one another" in str(result.assessment)


@pytest.mark.heavy
def test_flipped_targets_of_pairs_are_left_out_and_named() -> None:
    truth, samples = pose_pairs(3)
    flip = Rotation.from_euler("x", 30, degrees=True)
    for i in (2, 9, 14):
        seen = samples[i].camera_T_target
        wrong = Pose.from_rotation(seen.position_m, seen.rotation * flip)
        samples[i] = replace(samples[i], camera_T_target=wrong)
    result = paired(samples)
    assert {r.id for r in result.rejected} == {samples[i].id for i in (2, 9, 14)}
    assert holds(result, truth)


def views(seed: int) -> tuple[HandEyeResult, Truth]:
    truth, samples = general_scene(np.random.default_rng(seed))
    return solved(samples), truth


def pairs(seed: int, setup: Setup = Setup.EYE_TO_HAND) -> tuple[HandEyeResult, Truth]:
    truth, samples = pose_pairs(seed, 15, setup)
    return paired(samples, setup), truth


@pytest.mark.parametrize(
    ("kind", "seeds"),
    [(views, 3), (pairs, 2), (partial(pairs, setup=Setup.EYE_IN_HAND), 2),
     *heavy((views, 24), (pairs, 10), (partial(pairs, setup=Setup.EYE_IN_HAND), 10))],
    ids=["views", "pairs", "pairs, in hand", "many views", "many pairs", "many pairs, in hand"],
)  # fmt: skip
def test_confidence_region_has_the_stated_coverage(
    kind: Callable[[int], tuple[HandEyeResult, Truth]], seeds: int
) -> None:
    assert np.mean([holds(*kind(seed)) for seed in range(seeds)]) >= 0.85


@pytest.mark.heavy
@pytest.mark.parametrize("flipped", [0, 2])
def test_20_views_give_the_pose_within_a_millimetre_and_a_tenth_of_a_degree(flipped: int) -> None:
    """In 95 % of the trials; noise 0.2 px, and of the robot 0.1 mm and 0.02 degrees."""
    errors = []
    for seed in range(40):
        truth, samples = general_scene(np.random.default_rng((5, seed)), 20, flipped=flipped)
        found = solved(samples).pose
        assert found is not None
        errors.append(truth.error(found))
    mm, deg = np.array(errors).T
    assert np.percentile(mm, 95) < 1.0
    assert np.percentile(deg, 95) < 0.1
    assert np.median(mm) < 0.5
    assert np.median(deg) < 0.05


def unsure_camera(rng: Random | None) -> CameraModel:
    """A calibrated camera with focal lengths known to 6 px of 980; drawn: with an error of that size."""
    covariance = np.array([[36.0, 35.0, 0, 0], [35.0, 36.0, 0, 0], [0, 0, 4.0, 0], [0, 0, 0, 4.0]])
    off = np.zeros(4) if rng is None else rng.multivariate_normal(np.zeros(4), covariance)
    matrix = CAMERA.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += off
    return CameraModel(CAMERA.size, matrix, np.zeros(5), CameraUncertainty((0, 1, 2, 3), covariance))


@pytest.mark.heavy
def test_confidence_region_includes_the_cameras_uncertainty() -> None:
    held, held_without = [], []
    for seed in range(16):
        rng = np.random.default_rng((11, seed))
        truth, samples = general_scene(rng, 12)
        result = solved(samples, camera=unsure_camera(rng))
        held.append(holds(result, truth))
        held_without.append(holds(replace(result, covariance=result.covariance - result.from_camera), truth))
    assert np.mean(held) >= 0.85
    assert np.mean(held_without) <= 0.35, "the samples alone cannot know"


@pytest.mark.heavy
def test_verdict_names_the_input_that_limits_it() -> None:
    _, samples = general_scene(np.random.default_rng(1), 20)
    exact = solved(samples)
    assert exact.assessment.verdict is Verdict.GOOD
    assert exact.from_camera is not None
    assert not exact.from_camera.any()
    unsure = solved(samples, camera=unsure_camera(None))
    assert unsure.assessment.verdict is Verdict.WEAK
    assert "of it from the camera's intrinsics: calibrate the camera again" in str(unsure.assessment)
    assert "add samples" in str(solved(samples[:6]).assessment)
    doubted = CameraUncertainty(doubts=("corners cover 20% of the picture",))
    assert solved(samples, camera=replace(CAMERA, uncertainty=doubted)).assessment.doubts == (
        "depends on a camera that is not good (corners cover 20% of the picture)",
    )


def test_invalid_samples_are_left_out_and_named() -> None:
    truth, samples = general_scene(np.random.default_rng(4))
    seen = [sample.view for sample in samples]
    infinite = seen[1].image_px.copy()
    infinite[0, 0] = np.inf
    odd = [
        replace(samples[0], id="nan pose", base_T_tcp=Pose((float("nan"), 0.0, 0.0))),
        replace(samples[1], id="inf corner", view=replace(seen[1], image_px=infinite)),
        replace(samples[2], id="mm", base_T_tcp=Pose((450.0, 10.0, 300.0))),
        replace(samples[3], id="again"),
        replace(samples[4], id="size", view=replace(seen[4], size=(640, 480))),
        replace(samples[6], id="outside", view=replace(seen[6], image_px=seen[6].image_px + 2e3)),
        replace(samples[5], id="quaternion", base_T_tcp=Pose((0.4, 0.0, 0.3), (0.0, 0.0, 0.0, 0.9))),
    ]
    result = solved([*samples, *odd])
    assert {r.id for r in result.rejected} == {o.id for o in odd}
    assert [r.id for r in result.rejected if "outside the picture" in r.reason] == ["outside"]
    assert error_mm(result, truth) < 1.0


def test_next_pose_minimises_the_predicted_sigma() -> None:
    _, samples = general_scene(np.random.default_rng(6), 26)
    result = solved(samples[:6])
    candidates = [s.base_T_tcp for s in samples[6:]]
    others = [next_pose(result, CAMERA, [c]) for c in candidates]
    sigmas_m = {i: found[0] for i, found in enumerate(others) if found is not None}
    best = min(sigmas_m, key=lambda i: sigmas_m[i])
    assert next_pose(result, CAMERA, candidates) == (pytest.approx(sigmas_m[best]), best)
    assert next_pose(result, CAMERA, [Pose((9.0, 9.0, 9.0))]) is None


COUNT = 20
"""Samples of a case."""


def moved(kind: str, rng: Random) -> Scene:
    """Draw samples of a motion that constrains a hand-eye pose poorly. kind: a key of `turns` below."""
    moves = rng.uniform(-0.1, 0.1, (COUNT, 3))
    angles = np.radians(rng.uniform(-45, 45, COUNT))[:, None]
    axis = np.array([0.0, 0.6, 0.8])
    any_axis = rng.normal(0, 1, (COUNT, 3))
    any_axis /= np.linalg.norm(any_axis, axis=1, keepdims=True)
    near = axis + rng.normal(0, np.radians(3.0), (COUNT, 3))
    turns = {
        "near-parallel": angles * near / np.linalg.norm(near, axis=1, keepdims=True),
        "parallel": angles * axis,
        "small": any_axis * np.radians(rng.uniform(0, 1.5, COUNT))[:, None],
        "translation": np.zeros((COUNT, 3)),
        "identical": np.zeros((COUNT, 3)),
        "half turns": (np.pi * np.vstack([np.zeros(3), np.eye(3)]))[np.arange(COUNT) % 4],
        "rotation": any_axis * np.abs(angles),
    }[kind]
    still = kind in ("identical", "rotation")
    return motion_scene(rng, turns, np.zeros_like(moves) if still else moves)


def with_poses(change: Callable[[list[Pose], Random], list[Pose]], rng: Random) -> Scene:
    """Replace the robot's poses. change: returns the poses that are given instead of the true ones."""
    truth, samples = general_scene(rng, COUNT)
    given = change([sample.base_T_tcp for sample in samples], rng)
    return truth, [replace(s, base_T_tcp=pose) for s, pose in zip(samples, given, strict=True)]


def each_pose(change: Callable[[Pose, Random], Pose]) -> Callable[[Random], Scene]:
    return partial(with_poses, lambda poses, rng: [change(pose, rng) for pose in poses])


def shifted(spread_m: float, pose: Pose, rng: Random) -> Pose:
    return Pose.from_rotation(rng.normal(pose.position_m, spread_m), pose.rotation)


def as_euler(pose: Pose, _: Random) -> Pose:
    return Pose.from_rotation(pose.position_m, Rotation.from_euler("xyz", pose.rotation.as_rotvec()))


def in_mm(pose: Pose, _: Random) -> Pose:
    return Pose.from_rotation(1e3 * np.asarray(pose.position_m), pose.rotation)


def while_moving(poses: list[Pose], rng: Random) -> list[Pose]:
    return [shifted(0.02, pose, rng) if i in (4, 9) else pose for i, pose in enumerate(poses)]


MOTIONS: dict[str, tuple[Callable[[Random], Scene], tuple[str, ...]]] = {
    "near-parallel axes (3 degrees off)": (partial(moved, "near-parallel"), ("parallel",)),
    "exactly parallel axes": (partial(moved, "parallel"), ("parallel axes",)),
    "rotations below 3 degrees": (partial(moved, "small"), ("rotated by",)),
    "pure translation": (partial(moved, "translation"), ("rotated by",)),
    "all poses identical": (partial(moved, "identical"), ("same robot pose", "turned by")),
    "relative rotations of 180 degrees": (partial(moved, "half turns"), ("near 180",)),
    "rotation only, place fixed": (partial(moved, "rotation"), ()),
    "two flipped targets of ten": (lambda rng: general_scene(rng, COUNT, flipped=4), ("contradict",)),
    "pictures mispaired by one": (
        partial(with_poses, lambda poses, _: [*poses[1:], poses[0]]),
        ("paired with an offset",),
    ),
    "poses given inverted": (each_pose(lambda pose, _: pose.inverse()), ("inverted",)),
    "eye-in-hand solved as eye-to-hand": (
        lambda rng: general_scene(rng, COUNT, Setup.EYE_IN_HAND),
        ("inverted", "contradict"),
    ),
    "rotation vector read as Euler angles": (each_pose(as_euler), ("contradict",)),
    "positions in mm given as m": (each_pose(in_mm), ("usable sample",)),
    "target loose by a centimetre": (each_pose(partial(shifted, 0.01)), ("contradict",)),
    "two samples taken while moving": (partial(with_poses, while_moving), ()),
    "two samples": (lambda rng: general_scene(rng, 2), ("2 usable samples",)),
}
"""By name: a function that draws the samples; words of a refusal, if it must be refused."""


@pytest.mark.heavy
@pytest.mark.parametrize("draw", [0, *heavy(1, 2, 3, 4)])
@pytest.mark.parametrize("name", MOTIONS)
def test_bad_motion_is_refused_or_gives_a_correct_result(name: str, draw: int) -> None:
    """A weak answer may be wrong by four times its sigma, a good one by 1 mm."""
    make, reasons = MOTIONS[name]
    truth, samples = make(np.random.default_rng((0, list(MOTIONS).index(name), draw)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = solved(samples)
    if result.covariance is None:
        assert any(reason in str(result.assessment) for reason in reasons), result.assessment
    else:
        sigma_mm = 1e3 * float(np.sqrt(np.trace(result.covariance[3:, 3:])))
        assert error_mm(result, truth) <= (max(1.0, 4 * sigma_mm) if result.assessment.doubts else 1.0)


def about_one_axis(truth: Truth, samples: list[PoseSample]) -> list[PoseSample]:
    found = []
    for i, sample in enumerate(samples):
        turn = Pose.from_rotation((0.01 * i, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, 0.1 * i]))
        robot = samples[0].base_T_tcp @ turn
        seen = truth.x.inverse() @ robot @ truth.z
        found.append(replace(sample, base_T_tcp=robot, camera_T_target=seen))
    return found


def mispaired(_: Truth, samples: list[PoseSample]) -> list[PoseSample]:
    seen = [s.camera_T_target for s in samples]
    return [replace(s, camera_T_target=t) for s, t in zip(samples, seen[1:] + seen[:1], strict=True)]


@pytest.mark.parametrize(
    ("seed", "change", "reason"),
    [
        (7, about_one_axis, "parallel axes"),
        (7, lambda _, samples: samples[:4], "4 usable pairs"),
        (6, mispaired, "contradict"),
        (
            6,
            lambda _, samples: [replace(s, base_T_tcp=s.base_T_tcp.inverse()) for s in samples],
            "contradict",
        ),
    ],
    ids=["one axis", "few", "mispaired by one", "inverted"],
)
def test_pairs_that_do_not_fit_are_refused(
    seed: int, change: Callable[[Truth, list[PoseSample]], list[PoseSample]], reason: str
) -> None:
    result = paired(change(*pose_pairs(seed)))
    assert result.assessment.verdict is Verdict.REFUSED
    assert result.pose is None
    assert reason in str(result.assessment)


@pytest.mark.heavy
@pytest.mark.parametrize(("size", "verdict"), [(0.97, Verdict.WEAK), (1.2, Verdict.REFUSED)])
def test_size_of_a_target_in_pictures_is_named_before_its_mounting(size: float, verdict: Verdict) -> None:
    _, samples = general_scene(np.random.default_rng(5), 12)
    given = [replace(s, view=replace(s.view, board_m=s.view.board_m / size)) for s in samples]
    assessment = solved(given).assessment
    assert assessment.verdict is verdict
    said = str(assessment).partition("the robot's motions fit a target of ")[2]
    assert float(said.split()[0]) == pytest.approx(size, abs=0.004)
    assert "rigidly" not in str(assessment)
    assert "target of" not in str(solved(samples).assessment)


@pytest.mark.parametrize("size", [0.97, *heavy(1.05, 2.0)])
def test_target_of_another_size_is_rejected_with_the_ratio(size: float) -> None:
    _, samples = pose_pairs(4, 30, size=size, noise=0.5)
    result = paired(samples)
    assert result.pose is None
    said = result.assessment.refusals[0]
    assert "is its size right" in said
    assert float(said.split("look ")[1].split(" times")[0]) == pytest.approx(size, rel=0.02)


@pytest.mark.heavy
def test_correlated_errors_increase_sigma() -> None:
    truth, samples = pose_pairs(8, 60)
    drift = np.cumsum(np.random.default_rng(1).normal(0, 1e-3, (len(samples), 3)), axis=0)
    adrift = [
        replace(s, camera_T_target=s.camera_T_target.translated(*d))
        for s, d in zip(samples, drift, strict=True)
    ]
    plain, result = paired(samples), paired(adrift)
    assert "neighbouring" not in str(plain.assessment)
    assert "errors of neighbouring pairs are correlated" in str(result.assessment)
    assert plain.covariance is not None
    assert result.covariance is not None
    assert np.trace(result.covariance[3:, 3:]) > 4.0 * np.trace(plain.covariance[3:, 3:])
    assert holds(result, truth)


def repeated(pairs: list[PoseSample], order: Callable[[int], list[int]], jitter: float) -> list[PoseSample]:
    rng = np.random.default_rng(2)
    return [
        PoseSample(f"{i:03d}", jittered(pairs[k].base_T_tcp, rng, jitter), pairs[k].camera_T_target)
        for i, k in enumerate(order(len(pairs)))
    ]


@pytest.mark.heavy
@pytest.mark.parametrize("jitter", [1.0, *heavy(0.0)], ids=["with the robot's noise", "exact"])
@every_order
def test_repeated_pose_pairs_do_not_lower_sigma(order: Callable[[int], list[int]], jitter: float) -> None:
    _, samples = pose_pairs(0, 16, noise=0.25)
    once, found = paired(samples), paired(repeated(samples, order, jitter))
    assert found.covariance is not None
    assert once.covariance is not None
    assert found.samples <= 16
    assert {r.reason.split(" as ")[0] for r in found.rejected} == {"same robot pose"}
    assert np.sqrt(np.diag(found.covariance) / np.diag(once.covariance)).min() > 0.6


def test_few_poses_repeated_often_are_refused() -> None:
    _, samples = pose_pairs(0, 4, noise=0.25)
    found = paired(repeated(samples, ORDERS["each row five times"], 1.0))
    assert found.assessment.reasons == ("4 usable pairs; at least 5 are needed, 15 are good",)


@every_order
def test_repeated_pictures_at_jittered_robot_poses_count_once(order: Callable[[int], list[int]]) -> None:
    rng = np.random.default_rng(0)
    _, samples = general_scene(rng, 10)
    again = [
        replace(samples[k], id=f"{i:03d}", base_T_tcp=jittered(samples[k].base_T_tcp, rng, 1.0))
        for i, k in enumerate(order(10))
    ]
    assert len(solved(again).used) <= 10


@units
def test_robot_poses_of_another_unit_are_rejected(unit: str) -> None:
    reason = pose_fault(Pose(tuple(1e3 * IN_MM[unit] * v for v in (0.45, -0.2, 0.3))), "robot pose", 5.0)
    assert reason is None if unit == "metres" else unit in str(reason).split("; in ")[1]


TURN = Rotation.from_rotvec([0.4, -0.3, 0.2])


def matrix_with(turn: np.ndarray) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3] = turn
    return whole


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: pose_from_matrix(matrix_with(1.01 * TURN.as_matrix()), "pose"), "not orthonormal"),
        (lambda: pose_from_matrix(matrix_with(np.diag([1.0, 1.0, -1.0])), "pose"), "reflection"),
        (lambda: pose_from_rotation_vector((0, 0, 0), (90.0, 0, 0), "pose"), "degrees"),
        (lambda: pose_from_quaternion((0, 0, 0), 1.5 * TURN.as_quat(), "pose"), "length"),
        (lambda: pose_from_quaternion((0, 0, 0), np.zeros(4), "pose"), "length"),
    ],
    ids=["scaled", "reflected", "in degrees", "not normalised", "zeros"],
)
def test_invalid_rotation_is_rejected(make: Callable[[], Pose], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        make()


@pytest.mark.parametrize("angle_rad", [0.0, np.pi - 1e-9, np.pi, np.pi + TURN.magnitude()])
def test_rotation_vector_of_any_length_is_the_same_rotation(angle_rad: float) -> None:
    rotvec = angle_rad * TURN.as_rotvec() / TURN.magnitude()
    pose = pose_from_rotation_vector((0, 0, 0), rotvec, "pose")
    matrix = pose_from_matrix(matrix_with(Rotation.from_rotvec(rotvec).as_matrix()), "pose")
    for made in (pose, matrix):
        assert (made.rotation.inv() * Rotation.from_rotvec(rotvec)).magnitude() < 1e-7
