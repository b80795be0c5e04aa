"""Samples that disagree with each other: something changed between two of them."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.camera.intrinsics import assess_camera, calibrate_camera
from calibration.camera.model import CameraModel
from calibration.gripper import calibrate_pivot
from calibration.hand_eye.solve import HandEyeSample, Setup, calibrate_hand_eye
from calibration.order import FEWEST, Change, find_change
from calibration.targets.boards import View
from calibration.time_offset import make_stream, time_offset
from calibration.verdict import Verdict
from drivers.types import Pose
from support.board_scenes import BOARD, board_pose
from support.motions import CAMERA, general_scene, pivot_scene, wiggle_scene

SEEDS = range(5)


def line_fit(seed: int, jump: float, count: int = 16, shared: float = 0.0) -> Change | None:
    """Fit two parameters to samples of four rows; the first parameter jumps in the middle.

    shared: sigma of an error of each whole sample.
    """
    rng = np.random.default_rng(seed)
    jacobians = [rng.normal(size=(4, 2)) for _ in range(count)]
    measured = [
        j @ [jump * (i >= count // 2), 0.0] + rng.normal(size=4) + shared * (j @ rng.normal(size=2))
        for i, j in enumerate(jacobians)
    ]
    best, *_ = np.linalg.lstsq(np.vstack(jacobians), np.concatenate(measured), rcond=None)
    residuals = [values - j @ best for j, values in zip(jacobians, measured, strict=True)]
    return find_change([str(i) for i in range(count)], jacobians, residuals, {"size": rng.normal(size=count)})


@pytest.mark.parametrize("shared", [0.0, 0.5])
def test_samples_without_a_change_seldom_seem_to_have_one(shared: float) -> None:
    assert sum(line_fit(seed, 0.0, shared=shared) is not None for seed in range(100)) <= 3


@pytest.mark.parametrize("seed", SEEDS)
def test_change_is_found_where_it_is_and_sigma_covers_both_parts(seed: int) -> None:
    found = line_fit(seed, 5.0)
    assert found is not None
    assert (found.by, abs(int(found.last) - 7) <= 1) == ("", True)
    assert found.difference[0] == pytest.approx(5.0, abs=4.0 * found.sigma[0])
    assert abs(found.difference[1]) < 4.0 * found.sigma[1]
    assert 2.0 * np.sqrt(found.spread[0, 0]) > 4.0


def test_samples_are_also_ordered_by_a_quantity() -> None:
    rng = np.random.default_rng(0)
    size = rng.permutation(20)
    values = rng.normal(size=20) + 8.0 * (size >= 10)
    residuals = [np.array([value]) for value in values - values.mean()]
    found = find_change([str(i) for i in size], [np.ones((1, 1))] * 20, residuals, {"size": size})
    assert found is not None
    text = found.text([("the weight", 1.0, "kg", 0.1)], "weigh again")
    assert text.startswith(
        "samples with the smallest size, up to 9, and the others disagree: the weight diff"
    )
    assert text.endswith(" kg; weigh again")


def test_few_samples_are_not_compared() -> None:
    assert line_fit(0, 50.0, count=2 * FEWEST - 1) is None


def autofocus_views(seed: int, focal_px: tuple[float, float]) -> list[View]:
    rng = np.random.default_rng(seed)
    places, seen = np.asarray(BOARD.board().getChessboardCorners(), np.float64), []
    for i in range(16):
        camera, pose = CameraModel.pinhole((640, 480), focal_px[i // 8]), board_pose(rng, (5.0, 45.0))
        pixels = camera.project(pose.rotation.apply(places) + np.asarray(pose.position_m))
        inside = np.flatnonzero(((pixels > 3.0) & (pixels < np.subtract(camera.size, 4.0))).all(axis=1))
        pixels = rng.normal(pixels[inside], 0.06)
        seen.append(View(f"{i:02d}", inside, places[inside], pixels, camera.size))
    return [view for view in seen if len(view.ids) >= 12]


@pytest.mark.parametrize("seed", SEEDS)
def test_autofocus_between_two_views_is_found(seed: int) -> None:
    found = calibrate_camera(autofocus_views(seed, (620.0, 638.6)))
    assert found.change is not None
    assessment = assess_camera(found)
    assert assessment.verdict is not Verdict.GOOD
    assert any("and later samples disagree: the focal length f" in doubt for doubt in assessment.doubts)
    assert found.sigma[0] > 8.0, "sigma covers both focal lengths"
    steady = calibrate_camera(autofocus_views(seed, (620.0, 620.0)))
    assert (steady.change, assess_camera(steady).doubts) == (None, ())


def slipped(samples: list[HandEyeSample], truth: Pose, target: Pose, slip_m: float) -> list[HandEyeSample]:
    """Return samples whose target slips in the hand after the eighth, seen from the same place."""
    moved = Pose.from_rotation(np.add(target.position_m, [slip_m, 0.0, 0.0]), target.rotation)
    views = [truth.inverse() @ sample.base_T_tcp @ target for sample in samples[8:]]
    robots = [truth @ view @ moved.inverse() for view in views]
    later = [replace(s, base_T_tcp=robot) for s, robot in zip(samples[8:], robots, strict=True)]
    return samples[:8] + later


@pytest.mark.parametrize("seed", SEEDS)
def test_target_that_slips_in_the_hand_is_found(seed: int) -> None:
    truth, samples = general_scene(np.random.default_rng(seed), 16)
    found = calibrate_hand_eye(slipped(samples, truth.x, truth.z, 2e-3), CAMERA, Setup.EYE_TO_HAND)
    assert any("disagree: the target" in doubt for doubt in found.assessment.doubts), found.assessment
    assert found.pose is not None
    assert found.covariance is not None
    off = np.abs(truth.error_vector(found.pose)) / np.sqrt(np.diag(found.covariance))
    assert off.max() < 2.0, "sigma covers what the slip causes"


@pytest.mark.parametrize("seed", SEEDS)
def test_hole_that_moves_is_found(seed: int) -> None:
    tip, poses = pivot_scene(np.random.default_rng(seed), 12)
    shifted = [
        (name, Pose.from_rotation(np.add(pose.position_m, [1e-3, 0.0, 0.0]), pose.rotation))
        for name, pose in poses[6:]
    ]
    found = calibrate_pivot(poses[:6] + shifted)
    assert any(
        "up to 05 and later samples disagree: the hole's x" in doubt for doubt in found.assessment.doubts
    )
    assert found.tip_m is not None
    assert found.covariance is not None
    assert (np.abs(found.tip_m - tip) < 3.0 * np.sqrt(np.diag(found.covariance))).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_clock_that_is_set_while_recording_is_found(seed: int) -> None:
    robot, camera = wiggle_scene(np.random.default_rng(seed))
    times = camera.time_ns.copy()
    times[len(times) // 2 :] += 5_000_000
    found = time_offset(robot, make_stream(times, camera.values, "camera"))
    assert any("later samples disagree: the offset" in doubt for doubt in found.assessment.doubts)
    assert found.sigma_s is not None
    assert found.sigma_s > 2.5e-3, "sigma covers both offsets"
