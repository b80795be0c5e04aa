"""Hand-eye: closed forms compared with OpenCV, accuracy, sigma, and motions that do not determine it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.hand_eye.refine import park, shah
from calibration.hand_eye.solve import (
    HandEyeSample,
    Setup,
    calibrate_hand_eye,
    make_problem,
    next_pose,
    target_poses,
)
from calibration.verdict import Verdict
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import CAMERA, general_scene


def solved(samples: list[HandEyeSample], setup: Setup = Setup.EYE_TO_HAND):
    return calibrate_hand_eye(samples, CAMERA, setup)


def _poses(seed: int) -> tuple[np.ndarray, ...]:
    _, samples = general_scene(np.random.default_rng(seed), 12)
    problem = make_problem(samples, CAMERA, Setup.EYE_TO_HAND)
    turns, moves = target_poses(problem)
    return problem.a_R, problem.a_t, turns[:, 0], moves[:, 0]


def test_park_equals_opencv() -> None:
    a_R, a_t, b_R, b_t = _poses(3)  # noqa: N806
    inverse = a_R.transpose(0, 2, 1)
    back = -(inverse @ a_t[..., None])
    turn, move = cv2.calibrateHandEye(
        list(inverse), list(back), list(b_R), list(b_t[..., None]), method=cv2.CALIB_HAND_EYE_PARK
    )
    ours = park(a_R, a_t, b_R, b_t)
    assert ours.x_R == pytest.approx(turn, abs=1e-9)
    assert ours.x_t == pytest.approx(move.ravel(), abs=1e-9)
    assert ours.z_t == pytest.approx(shah(a_R, a_t, b_R, b_t).z_t, abs=1e-2)


def test_shah_equals_opencv() -> None:
    a_R, a_t, b_R, b_t = _poses(4)  # noqa: N806
    z_R, z_t, x_R, x_t = cv2.calibrateRobotWorldHandEye(  # noqa: N806
        list(a_R),
        list(a_t[..., None]),
        list(b_R),
        list(b_t[..., None]),
        method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    )
    ours = shah(a_R, a_t, b_R, b_t)
    assert ours.x_R == pytest.approx(x_R, abs=1e-6)
    assert ours.x_t == pytest.approx(x_t.ravel(), abs=1e-6)
    assert ours.z_R == pytest.approx(z_R, abs=1e-6)
    assert ours.z_t == pytest.approx(z_t.ravel(), abs=1e-6)


def test_flipped_samples_are_left_out_and_named() -> None:
    truth, samples = general_scene(np.random.default_rng(2), 20, flipped=2)
    result = solved(samples)
    assert {r.id for r in result.rejected} == {"00", "01"}
    assert result.pose is not None
    assert truth.error(result.pose)[0] < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [6, pytest.param(24, marks=pytest.mark.long)])
def test_confidence_region_has_the_stated_coverage(seeds: int) -> None:
    held = []
    for seed in range(seeds):
        truth, samples = general_scene(np.random.default_rng(seed))
        result = solved(samples)
        assert result.pose is not None
        held.append(result.holds(truth.error_vector(result.pose)))
    assert 0.85 <= np.mean(held) <= 1.0


def unsure_camera(rng: np.random.Generator | None) -> CameraModel:
    """A calibrated camera with focal lengths known to 6 px of 980; drawn: with an error of that size."""
    covariance = np.array([[36.0, 35.0, 0, 0], [35.0, 36.0, 0, 0], [0, 0, 4.0, 0], [0, 0, 0, 4.0]])
    known = CameraUncertainty((0, 1, 2, 3), covariance)
    off = np.zeros(4) if rng is None else rng.multivariate_normal(np.zeros(4), covariance)
    matrix = CAMERA.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += off
    return CameraModel(CAMERA.size, matrix, np.zeros(5), known)


@pytest.mark.slow
@pytest.mark.long
def test_confidence_region_includes_the_cameras_uncertainty() -> None:
    held, held_without = [], []
    for seed in range(16):
        rng = np.random.default_rng((11, seed))
        truth, samples = general_scene(rng, 12)
        result = calibrate_hand_eye(samples, unsure_camera(rng), Setup.EYE_TO_HAND)
        assert result.pose is not None
        error = truth.error_vector(result.pose)
        held.append(result.holds(error))
        alone = replace(result, covariance=result.covariance - result.from_camera)
        held_without.append(alone.holds(error))
    assert np.mean(held) >= 0.85
    assert np.mean(held_without) <= 0.35, "the samples alone cannot know"


def test_verdict_names_the_input_that_limits_it() -> None:
    _, samples = general_scene(np.random.default_rng(1), 20)
    exact = calibrate_hand_eye(samples, CAMERA, Setup.EYE_TO_HAND)
    assert exact.assessment.verdict is Verdict.GOOD
    assert exact.from_camera is not None
    assert not exact.from_camera.any()
    unsure = calibrate_hand_eye(samples, unsure_camera(None), Setup.EYE_TO_HAND)
    assert unsure.assessment.verdict is Verdict.WEAK
    assert "of it from the camera's intrinsics: calibrate the camera again" in str(unsure.assessment)
    few = calibrate_hand_eye(samples[:6], CAMERA, Setup.EYE_TO_HAND)
    assert "add samples" in str(few.assessment)


def test_too_few_samples_are_rejected() -> None:
    _, samples = general_scene(np.random.default_rng(1), 6)
    result = calibrate_hand_eye(samples[:2], CAMERA, Setup.EYE_TO_HAND)
    assert result.pose is None
    assert "2 usable samples" in str(result.assessment)


def test_verdict_is_at_most_that_of_the_camera() -> None:
    _, samples = general_scene(np.random.default_rng(1), 20)
    doubted = CameraUncertainty(doubts=("corners cover 20% of the picture",))
    result = calibrate_hand_eye(samples, replace(CAMERA, uncertainty=doubted), Setup.EYE_TO_HAND)
    assert result.assessment.doubts == (
        "depends on a camera that is not good (corners cover 20% of the picture)",
    )


def test_invalid_samples_are_left_out_and_named() -> None:
    truth, samples = general_scene(np.random.default_rng(4))
    view = samples[1].view
    nan = view.image_px.copy()
    nan[0, 0] = np.inf
    odd = [
        replace(samples[0], id="nan pose", base_T_tcp=Pose((float("nan"), 0.0, 0.0))),
        replace(samples[1], id="inf corner", view=replace(view, image_px=nan)),
        replace(samples[2], id="mm", base_T_tcp=Pose((450.0, 10.0, 300.0))),
        replace(samples[3], id="again"),
        replace(samples[4], id="size", view=replace(samples[4].view, size=(640, 480))),
        replace(
            samples[6], id="outside", view=replace(samples[6].view, image_px=samples[6].view.image_px + 2e3)
        ),
        replace(samples[5], id="quaternion", base_T_tcp=Pose((0.4, 0.0, 0.3), (0.0, 0.0, 0.0, 0.9))),
    ]
    result = solved([*samples, *odd])
    assert {r.id for r in result.rejected} == {o.id for o in odd}
    assert [r.id for r in result.rejected if "outside the picture" in r.reason] == ["outside"]
    assert result.pose is not None
    assert truth.error(result.pose)[0] < 1.0


def test_next_pose_minimises_the_predicted_sigma() -> None:
    _, samples = general_scene(np.random.default_rng(6), 26)
    result = solved(samples[:6])
    candidates = [s.base_T_tcp for s in samples[6:]]
    choice = next_pose(result, CAMERA, candidates)
    assert choice is not None
    others = [next_pose(result, CAMERA, [c]) for c in candidates]
    assert choice[0] == pytest.approx(min(o[0] for o in others if o is not None))
    assert next_pose(result, CAMERA, [Pose((9.0, 9.0, 9.0))]) is None
