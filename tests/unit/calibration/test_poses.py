"""Poses from the numbers people have, checked first."""

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.poses import pose_from_matrix, pose_from_quaternion, pose_from_rotation_vector


def test_poses_from_numbers_are_checked() -> None:
    turn = Rotation.from_rotvec([0.1, 0.2, 0.3])
    good = np.eye(4)
    good[:3, :3], good[:3, 3] = turn.as_matrix(), (0.4, 0.1, 0.2)
    assert pose_from_matrix(good, "p").rotation.approx_equal(turn)
    quaternion = turn.as_quat()
    for sign in (1, -1):
        assert pose_from_quaternion((0.4, 0.1, 0.2), sign * quaternion, "p").rotation.approx_equal(turn)
    long_way = turn.as_rotvec() * (1 - 2 * np.pi / turn.magnitude())
    assert pose_from_rotation_vector((0, 0, 0), long_way, "p").rotation.approx_equal(turn)
