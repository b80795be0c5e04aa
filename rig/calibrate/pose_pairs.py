"""`rig calibrate hand-eye` from poses of the target instead of pictures, as another detector gave them."""

from pathlib import Path

import numpy as np

from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.pose_solve import PosePairResult, calibrate_pose_pairs
from calibration.hand_eye.samples import Setup
from calibration.verdict import Rejected
from rig.calibrate.hand_eye import place_value, poses_picture
from rig.calibrate.result import CalibrationResult
from rig.calibrate.sources import read_poses

TARGETS = "targets.csv"
_NOISE = ("robot_turn_rad", "robot_m", "tilt_rad", "turn_rad", "across_m", "depth_m")
"""Of the robot's poses, then of the target's."""


def hand_eye_from_poses(folder: Path, serial: str, setup: Setup) -> CalibrationResult:
    """Pair `poses.csv` (base_T_tcp) and `targets.csv` (camera_T_target) by id, and solve.

    Raises `InputError`.
    """
    files = [folder / "poses.csv", folder / TARGETS]
    (robot, rejected), (seen, also) = (read_poses(path) for path in files)
    rejected = rejected + also
    rejected += [Rejected(name, "no pose of the target of this id") for name in robot.keys() - seen.keys()]
    rejected += [Rejected(name, "no robot pose of this id") for name in seen.keys() - robot.keys()]
    samples = [PoseSample(name, robot[name], seen[name]) for name in robot if name in seen]
    result = calibrate_pose_pairs(samples, setup)
    return CalibrationResult(
        "hand-eye", {"camera": serial}, place_value(setup, result.pose, result.target), _quality(result),
        result.assessment, _numbers(result), str(folder), len(result.used),
        [*rejected, *result.rejected], files,
        poses_picture(setup, result.pose, result.target, [robot[name] for name in result.used]),
    )  # fmt: skip


def _quality(result: PosePairResult) -> dict[str, object]:
    if result.covariance is None or result.sigmas is None:
        return {}
    return {
        "covariance_order": "rotation vector about the child's axes (rad), translation in the parent (m)",
        "covariance": result.covariance,
        "covariance_of_target": result.target_covariance,
        "noise_found": dict(zip(_NOISE, result.sigmas.tolist(), strict=True)),
    }


def _numbers(result: PosePairResult) -> dict[str, str]:
    if result.pose is None or result.covariance is None or result.sigmas is None:
        return {}
    sigma = np.sqrt(np.diag(result.covariance))
    robot, seen = result.sigmas[:2], result.sigmas[2:]
    return {
        "position": ", ".join(f"{v:.5f}" for v in result.pose.position_m) + " m",
        "orientation (xyzw)": ", ".join(f"{v:.6f}" for v in result.pose.quaternion_xyzw),
        "one sigma, position": " / ".join(f"{1e3 * v:.2f}" for v in sigma[3:]) + " mm",
        "one sigma, orientation": " / ".join(f"{np.degrees(v):.3f}" for v in sigma[:3]) + " degrees",
        "noise found, robot": f"{np.degrees(robot[0]):.3f} degrees, {1e3 * robot[1]:.2f} mm",
        "noise found, target's pose": f"tilt {np.degrees(seen[0]):.3f}, turn {np.degrees(seen[1]):.3f} "
        f"degrees, across {1e3 * seen[2]:.2f}, depth {1e3 * seen[3]:.2f} mm",
    }
