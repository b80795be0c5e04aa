"""Hand-eye from pairs of poses: exact data, sigma under noise, refusal of undetermined motions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.hand_eye.pose_pairs import calibrate_pose_pairs
from calibration.hand_eye.solve import HandEyeResult, Setup
from calibration.verdict import Verdict
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import Truth
from support.marks import long
from support.motions import pose_pairs


def holds(result: HandEyeResult, truth: Truth) -> bool:
    assert result.pose is not None
    return result.holds(truth.error_vector(result.pose))


@pytest.mark.parametrize("setup", list(Setup))
def test_exact_pairs_give_the_exact_transform(setup: Setup) -> None:
    truth, samples = pose_pairs(0, 12, setup, noise=0.0)
    result = calibrate_pose_pairs(samples, setup)
    assert result.pose is not None
    assert result.target is not None
    assert truth.error(result.pose) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert np.allclose(result.target.position_m, truth.z.position_m, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [4, pytest.param(10, marks=pytest.mark.long)])
@pytest.mark.parametrize("setup", list(Setup))
def test_confidence_region_has_the_stated_coverage(setup: Setup, seeds: int) -> None:
    held = []
    for seed in range(seeds):
        truth, samples = pose_pairs(seed, 15, setup)
        held.append(holds(calibrate_pose_pairs(samples, setup), truth))
    assert np.mean(held) >= 0.85


@pytest.mark.slow
def test_flipped_targets_are_left_out_and_named() -> None:
    truth, samples = pose_pairs(3)
    flip = Rotation.from_euler("x", 30, degrees=True)
    for i in (2, 9, 14):
        seen = samples[i].camera_T_target
        samples[i] = replace(
            samples[i], camera_T_target=Pose.from_rotation(seen.position_m, seen.rotation * flip)
        )
    result = calibrate_pose_pairs(samples, Setup.EYE_TO_HAND)
    assert {r.id for r in result.rejected} == {samples[i].id for i in (2, 9, 14)}
    assert holds(result, truth)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.97, *long(1.05, 2.0)])
def test_target_of_another_size_is_rejected_with_the_ratio(size: float) -> None:
    _, samples = pose_pairs(4, 30, size=size, noise=0.5)
    result = calibrate_pose_pairs(samples, Setup.EYE_TO_HAND)
    assert result.pose is None
    said = result.assessment.refusals[0]
    assert "is its size right" in said
    assert float(said.split("look ")[1].split(" times")[0]) == pytest.approx(size, rel=0.02)


def test_pairs_shifted_by_one_and_inverted_poses_are_refused() -> None:
    _, samples = pose_pairs(6)
    seen = [s.camera_T_target for s in samples]
    shifted = [replace(s, camera_T_target=t) for s, t in zip(samples, seen[1:] + seen[:1], strict=True)]
    inverted = [replace(s, base_T_tcp=s.base_T_tcp.inverse()) for s in samples]
    for wrong in (shifted, inverted):
        result = calibrate_pose_pairs(wrong, Setup.EYE_TO_HAND)
        assert result.assessment.verdict is Verdict.REFUSED
        assert result.pose is None


def test_motions_about_one_axis_and_too_few_pairs_are_refused() -> None:
    truth, samples = pose_pairs(7)
    first = samples[0].base_T_tcp
    about_z = []
    for i, sample in enumerate(samples):
        robot = first @ Pose.from_rotation((0.01 * i, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, 0.1 * i]))
        seen = truth.x.inverse() @ robot @ truth.z
        about_z.append(replace(sample, base_T_tcp=robot, camera_T_target=seen))
    assert "parallel axes" in str(calibrate_pose_pairs(about_z, Setup.EYE_TO_HAND).assessment)
    assert "usable pairs" in str(calibrate_pose_pairs(samples[:4], Setup.EYE_TO_HAND).assessment)


@pytest.mark.slow
def test_correlated_errors_increase_sigma() -> None:
    truth, samples = pose_pairs(8, 60)
    rng = np.random.default_rng(1)
    drift = np.cumsum(rng.normal(0, 1e-3, (len(samples), 3)), axis=0)
    adrift = [
        replace(s, camera_T_target=replace(t, position_m=tuple(np.add(t.position_m, d))))
        for s, d in zip(samples, drift, strict=True)
        if (t := s.camera_T_target)
    ]
    plain, result = (calibrate_pose_pairs(s, Setup.EYE_TO_HAND) for s in (samples, adrift))
    assert "neighbouring" not in str(plain.assessment)
    assert "errors of neighbouring pairs are correlated" in str(result.assessment)
    assert plain.covariance is not None
    assert result.covariance is not None
    assert np.trace(result.covariance[3:, 3:]) > 4.0 * np.trace(plain.covariance[3:, 3:])
    assert holds(result, truth)
