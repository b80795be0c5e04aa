"""Time offsets, pivots and gripper tables: correct, or refused with the reason."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.gripper import Direction, OpeningSample, calibrate_opening, calibrate_pivot
from calibration.time_offset import make_stream, time_offset, turning_rate
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import wiggle_scene
from support.motions import pivot_scene


def test_offset_from_a_wiggle_is_within_its_sigma() -> None:
    errors, sigmas = [], []
    for seed in range(20):
        robot, camera = wiggle_scene(np.random.default_rng(seed), offset_s=0.0473)
        found = time_offset(robot, camera)
        assert found.offset_s is not None
        assert found.sigma_s is not None
        errors.append(found.offset_s - 0.0473)
        sigmas.append(found.sigma_s)
    assert np.percentile(np.abs(errors), 95) < 1e-3
    assert 0.5 < np.std(errors) / np.mean(sigmas) < 2.0


def test_offset_of_two_pose_streams_follows_from_their_turning_rates() -> None:
    """The second sees the motion from another pose, 80 ms late, at 30 Hz with noise and half its frames."""
    rng = np.random.default_rng(2)

    def turn(t: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(
            np.stack([0.4 * np.sin(1.7 * t), 0.5 * np.sin(2.9 * t + 1), 0.3 * np.sin(4.1 * t)], axis=1)
        )

    robot_s, camera_s = np.arange(0, 12, 0.002), np.sort(rng.choice(np.arange(0, 12, 1 / 30), 200, False))
    noise = Rotation.from_rotvec(rng.normal(0, 2e-3, (len(camera_s), 3)))
    mounted, placed = Rotation.random(2, rng=3)
    robot = turning_rate((robot_s * 1e9).astype(np.int64), turn(robot_s).as_quat(), "robot")
    late = ((camera_s + 0.08) * 1e9).astype(np.int64)
    camera = turning_rate(late, (placed * turn(camera_s) * mounted * noise).as_quat(), "camera")
    found = time_offset(robot, camera)
    assert found.offset_s == pytest.approx(-0.08, abs=5e-3)


def test_invalid_orientations_are_discarded_or_rejected() -> None:
    times = np.arange(60) * 10_000_000
    turns = Rotation.from_rotvec(np.outer(np.arange(60) * 0.01, [0, 0, 1.0])).as_quat()
    turns[5] = np.nan
    turns[7] = 0.0
    rate = turning_rate(times, turns, "camera")
    assert rate.values == pytest.approx(1.0, rel=1e-6)
    with pytest.raises(CalibrationError, match="no orientations over"):
        turning_rate(times, np.zeros((60, 4)), "camera")
    with pytest.raises(CalibrationError, match="quaternions"):
        turning_rate(times, turns[:, :3], "camera")


def test_clock_drift_is_estimated_over_minutes() -> None:
    robot, camera = wiggle_scene(np.random.default_rng(1), seconds=240.0, drift_ppm=80.0)
    found = time_offset(robot, camera)
    assert found.drift_ppm is not None
    assert found.drift_ppm == pytest.approx(80.0, abs=4 * (found.drift_sigma_ppm or 0) + 1)


def test_streams_are_sorted_and_cleaned() -> None:
    rng = np.random.default_rng(2)
    robot, camera = wiggle_scene(rng)
    order = rng.permutation(len(camera.time_ns))
    times, values = (
        np.append(camera.time_ns[order], camera.time_ns[:5]),
        np.append(camera.values[order], np.zeros(5)),
    )
    values[3] = np.nan
    mixed = make_stream(times, values, "camera")
    assert len(mixed.time_ns) == len(times) - 6
    assert abs(time_offset(robot, mixed).offset_s - time_offset(robot, camera).offset_s) < 2e-4  # type: ignore[operator]


def test_pivot_is_within_its_sigma_and_a_slipped_sample_is_rejected() -> None:
    tip, poses = pivot_scene(np.random.default_rng(0), 14)
    moved = Pose(tuple(np.add(poses[3][1].position_m, (0.01, 0, 0))), poses[3][1].quaternion_xyzw)  # type: ignore[arg-type]
    poses[3] = ("slipped", moved)
    found = calibrate_pivot(poses)
    assert found.tip_m is not None
    assert found.covariance is not None
    off = found.tip_m - tip
    assert np.linalg.norm(off) < 1e-3
    assert off @ np.linalg.solve(found.covariance, off) < 20.0
    assert [r.id for r in found.rejected] == ["slipped"]


def _openings(noise_m: float = 0.0, lag_m: float = 0.0) -> list[OpeningSample]:
    rng = np.random.default_rng(0)
    made = []
    for direction, offset in ((Direction.CLOSING, 0.0), (Direction.OPENING, lag_m)):
        for counts in range(10, 210, 20):
            opening = 0.12 - 0.0005 * counts - 1e-7 * counts**2 + rng.normal(0, noise_m)
            opening += offset * counts / 190
            made.append(OpeningSample(f"{direction}{counts}", counts, opening, direction))
    return made


def test_opening_table_is_monotone_and_hysteresis_is_measured() -> None:
    found = calibrate_opening(_openings(5e-5, 7e-4))
    assert found.assessment.verdict is Verdict.GOOD
    assert found.hysteresis_m == pytest.approx(7e-4, abs=2e-4)
    table = found.tables[Direction.CLOSING]
    assert (np.diff(table.opening_m) <= 0).all()
    truth = 0.12 - 0.0005 * 90 - 1e-7 * 90**2
    assert table.opening_m[list(table.counts).index(90)] == pytest.approx(truth, abs=3e-4)


@pytest.mark.parametrize(
    ("way", "verdict", "said"),
    [(Direction.CLOSING, Verdict.WEAK, "hysteresis is unknown"),
     (Direction.OPENING, Verdict.REFUSED, "0 usable measurements while closing")],
)  # fmt: skip
def test_opening_measured_in_one_direction(way: Direction, verdict: Verdict, said: str) -> None:
    found = calibrate_opening([s for s in _openings() if s.direction is way])
    assert found.assessment.verdict is verdict
    assert said in found.assessment.reasons[0]
