"""The noise of the simulated arm's joint angles, in the process and over the wire protocol."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.clock import NS_PER_S
from drivers.types import Pose, Vector6
from fakes.clock import SimulatedClock
from fakes.devices.arm import FakeArm
from fakes.faults import FaultScript
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.world.kinematics import ENCODER_RAD, PHYSICAL_TOOL, compose, forward
from support.benches import NOISE_M
from support.worlds import HOME, empty_world

Samples = tuple[list[Vector6], list[Pose]]


def in_process(seed: int) -> Samples:
    clock = SimulatedClock()
    arm = FakeArm(empty_world(seed), clock, FaultScript())
    arm.connect()
    states = []
    for _ in range(400):
        clock.sleep_until(clock.now_ns() + NS_PER_S // 125)
        states.append(arm.state())
    return [state.joints_rad for state in states], [state.base_T_tcp for state in states]


def over_the_wire(seed: int) -> Samples:
    robot, joints, poses = Robot(empty_world(seed), (5, 11, 0, 0)), [], []
    for _ in range(400):
        robot.cycle(robot.time_ns + CYCLE_NS)
        joints.append(robot.bank.get("actual_q"))
        x, y, z, *turn = robot.bank.get("actual_TCP_pose")  # type: ignore[misc]
        poses.append(Pose.from_rotation((x, y, z), Rotation.from_rotvec(turn)))
    assert robot.bank.get("target_q") == robot.body.q
    return joints, poses


@pytest.mark.parametrize("samples", [in_process, over_the_wire])
def test_arm_at_rest_reports_joints_and_pose_with_noise(samples: Callable[[int], Samples]) -> None:
    joints, poses = samples(1)
    assert np.std(joints, axis=0) == pytest.approx(np.full(6, ENCODER_RAD), rel=0.2)
    assert np.allclose(poses[7].position_m, compose(forward(joints[7]), PHYSICAL_TOOL)[:3], atol=1e-9)
    off = np.subtract([pose.position_m for pose in poses], HOME.position_m)
    assert 1e-5 < np.abs(off).max() < NOISE_M
    assert samples(1)[0] == joints
    assert samples(2)[0] != joints
