"""Samples that repeat another one count once: otherwise sigma and held-out errors would be too small."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.gripper import Direction, OpeningSample, calibrate_opening, calibrate_pivot
from calibration.hand_eye.pose_pairs import PoseSample, calibrate_pose_pairs
from calibration.hand_eye.solve import Setup, calibrate_hand_eye
from calibration.time_offset import TimedSignal, make_stream, time_offset
from calibration.verdict import Verdict
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import CAMERA, general_scene, wiggle_scene
from support.motions import pivot_scene, pose_pairs

Order = Callable[[int], list[int]]
ORDERS: dict[str, Order] = {
    "each row five times": lambda count: [i for i in range(count) for _ in range(5)],
    "table five times": lambda count: list(range(count)) * 5,
    "rows at random": lambda count: np.random.default_rng(1).integers(0, count, 5 * count).tolist(),
    "first row forty times": lambda count: [0] * 40 + list(range(1, count)),
    "there and back": lambda count: list(range(count)) + list(range(count))[::-1],
}
every_order = pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
every_jitter = pytest.mark.parametrize("jitter", [0.0, 1.0], ids=["exact", "with the robot's noise"])


def _jittered(pose: Pose, rng: np.random.Generator, jitter: float) -> Pose:
    """Add a robot's noise: 0.1 mm and 0.02 degrees."""
    turn = Rotation.from_rotvec(rng.normal(0, 3e-4, 3) * jitter)
    return Pose.from_rotation(rng.normal(pose.position_m, 1e-4 * jitter), pose.rotation * turn)


def _repeated(pairs: list[PoseSample], order: Order, jitter: float) -> list[PoseSample]:
    rng = np.random.default_rng(2)
    return [
        PoseSample(f"{i:03d}", _jittered(pairs[k].base_T_tcp, rng, jitter), pairs[k].camera_T_target)
        for i, k in enumerate(order(len(pairs)))
    ]


@every_jitter
@every_order
def test_repeated_pose_pairs_do_not_lower_sigma(order: Order, jitter: float) -> None:
    _, pairs = pose_pairs(0, 16, noise=0.25)
    once = calibrate_pose_pairs(pairs, Setup.EYE_TO_HAND)
    found = calibrate_pose_pairs(_repeated(pairs, order, jitter), Setup.EYE_TO_HAND)
    assert found.covariance is not None
    assert once.covariance is not None
    assert found.samples <= 16
    assert {r.reason.split(" as ")[0] for r in found.rejected} == {"same robot pose"}
    ratio = np.sqrt(np.diag(found.covariance) / np.diag(once.covariance))
    assert ratio.min() > 0.6


def test_few_poses_repeated_often_are_refused() -> None:
    _, pairs = pose_pairs(0, 4, noise=0.25)
    found = calibrate_pose_pairs(_repeated(pairs, ORDERS["each row five times"], 1.0), Setup.EYE_TO_HAND)
    assert found.assessment.reasons == ("4 usable pairs; at least 5 are needed, 15 are good",)


@every_order
def test_repeated_pictures_at_jittered_robot_poses_count_once(order: Order) -> None:
    rng = np.random.default_rng(0)
    _, samples = general_scene(rng, 10)
    again = [
        replace(samples[k], id=f"{i:03d}", base_T_tcp=_jittered(samples[k].base_T_tcp, rng, 1.0))
        for i, k in enumerate(order(10))
    ]
    assert len(calibrate_hand_eye(again, CAMERA, Setup.EYE_TO_HAND).used) <= 10


@every_jitter
@every_order
def test_repeated_poses_of_the_pivot_count_once(order: Order, jitter: float) -> None:
    rng = np.random.default_rng(0)
    _, poses = pivot_scene(rng, 10)
    again = [(f"{i:03d}", _jittered(poses[k][1], rng, jitter)) for i, k in enumerate(order(10))]
    found = calibrate_pivot(again)
    assert len(found.residual_m or {}) <= 10


@pytest.mark.parametrize("apart_ns", [0, 1, 1_000, 50_000])
@pytest.mark.parametrize("repeats", [2, 5, 20])
def test_repeated_samples_of_a_stream_do_not_lower_sigma(repeats: int, apart_ns: int) -> None:
    def again(stream: TimedSignal) -> TimedSignal:
        shifts = np.arange(repeats) * apart_ns // repeats
        times = (stream.time_ns[:, None] // 100_000 * 100_000 + shifts).ravel()
        return make_stream(times, np.repeat(stream.values, repeats), "stream")

    streams = wiggle_scene(np.random.default_rng(0))
    once, found = time_offset(*streams), time_offset(*map(again, streams))
    assert once.sigma_s is not None
    assert found.sigma_s == pytest.approx(once.sigma_s, rel=0.05)
    assert found.used == once.used


@pytest.mark.parametrize("apart", [0.0, 0.1, 0.3])
def test_repeated_openings_do_not_make_a_table_of_few_positions_good(apart: float) -> None:
    counts = [c + apart * k for c in (10, 100, 200) for k in range(3)]
    samples = [
        OpeningSample(f"{way}{i}", c, 0.14 - 5e-4 * c, way) for way in Direction for i, c in enumerate(counts)
    ]
    found = calibrate_opening(samples)
    assert "3 counts measured; 8 are good" in found.assessment.reasons
    two = calibrate_opening([s for s in samples if s.counts < 150])
    assert two.assessment.verdict is Verdict.REFUSED
