"""The closed kinematics of the simulated arm against its chain of joints; its transforms against scipy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.world import kinematics as ur_frames
from fakes.world.kinematics import ELBOW_UP, forward, nearest_inverse, tracked_inverse
from fakes.world.motion import tool_tilt

joints = st.tuples(*[st.floats(-3.1, 3.1)] * 6)
poses = st.tuples(*[st.floats(-1.0, 1.0)] * 3, *[st.floats(-1.8, 1.8)] * 3)


def test_tilt_of_a_downward_tool_is_its_rotation_about_the_negative_y_axis():
    down = Rotation.from_euler("x", 180, degrees=True)
    turned = Rotation.from_rotvec([0.0, -0.1, 0.0]) * down
    assert tool_tilt(Pose.from_rotation((0.4, 0.0, 0.2), turned)) == pytest.approx(0.1)


def test_forward_kinematics_match_a_state_of_urs_controller():
    """A UR5e's state in the tests of UR's C++ client library (robot_state of test_primary_parser.cpp)."""
    flange = forward((-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031))
    position, rotation = (-0.143968657, -0.435620061, 0.202030025), (-0.00122136, 3.11627653, 0.03889192)
    assert np.allclose(ur_frames.to_ur(flange), (*position, *rotation), atol=1e-8)


@given(joints)
def test_forward_kinematics_are_the_chain_of_denavit_and_hartenberg(q):
    """Parameters: Universal Robots, DH page."""
    turn, place = Rotation.identity(), np.zeros(3)
    d, a = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
    for angle, d_m, a_m, alpha in zip(q, d, a, np.pi / 2 * np.array((1, 0, 0, 1, -1, 0)), strict=True):
        turn = turn * Rotation.from_euler("z", angle)
        place = place + turn.apply((a_m, 0.0, d_m))
        turn = turn * Rotation.from_euler("x", alpha)
    frame = forward(q)
    assert np.allclose(frame[:3], place, atol=1e-12)
    assert np.allclose(np.reshape(frame[3:], (3, 3)), turn.as_matrix(), atol=1e-12)


@given(joints)
def test_inverse_kinematics_return_the_original_pose(q):
    frame = forward(q)
    solution = nearest_inverse(frame, q)
    assert solution is not None
    assert np.allclose(forward(solution), frame, atol=1e-7)


@given(joints, st.tuples(*[st.floats(-1e-3, 1e-3)] * 6))
def test_joints_are_continuous_along_a_path(q, step):
    # not at a boundary between branches: stretched or folded elbow, aligned wrist, shoulder over the base
    if min(abs(math.sin(q[2])), abs(math.sin(q[4]))) < 0.05 or math.hypot(*forward(q)[:2]) < 0.3:
        return
    target = forward(tuple(a + b for a, b in zip(q, step, strict=True)))
    solution = tracked_inverse(target, q)
    if solution is not None:
        assert np.allclose(forward(solution), target, atol=1e-9)


def test_unreachable_pose_gives_none():
    far = ur_frames.from_ur((1.2, 0.0, 0.3, math.pi, 0.0, 0.0))
    assert nearest_inverse(far, ELBOW_UP) is None
    assert tracked_inverse(far, ELBOW_UP) is None


@given(poses)
def test_pose_is_unchanged_by_the_controllers_notation(pose):
    frame = ur_frames.from_ur(pose)
    assert np.allclose(np.reshape(frame[3:], (3, 3)), Rotation.from_rotvec(pose[3:]).as_matrix(), atol=1e-12)
    assert np.allclose(ur_frames.from_ur(ur_frames.to_ur(frame)), frame, atol=1e-9)
    assert np.allclose(ur_frames.from_pose(ur_frames.to_pose(frame)), frame, atol=1e-9)
