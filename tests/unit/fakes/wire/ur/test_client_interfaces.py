"""The states on ports 30001 to 30003, held to UR's guides and to a state that UR publishes."""

import math
import struct

import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose, Vector6
from fakes.wire.ur import loads
from fakes.wire.ur.body import Body
from fakes.wire.ur.client_interfaces import dexterity, realtime_state, robot_state, version_message
from fakes.wire.ur.frames import to_ur
from fakes.wire.ur.kinematics import forward
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.safety import RobotMode
from fakes.wire.ur.script import ScriptProgram
from fakes.wire.ur.user_programs.run import ScriptRun
from fakes.world.world import BenchLayout, World

# A UR5e's state as in the tests of UR's C++ client library (robot_state of test_primary_parser.cpp).
UR_JOINTS: Vector6 = (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031)
UR_POSE = (
    -0.14396865671352,
    -0.4356200608032,
    0.2020300254284,
    -0.001221359682,
    3.116276528482,
    0.0388919156,
)
UR_CURRENTS_A = (0.0, 2.14101, 1.49267, 0.23314, 0.00175, 0.0)
UR_DEXTERITY = 0.0035351144450041
PACKAGES = {0: 47, 1: 251, 4: 101, 5: 225, 3: 75, 2: 37, 6: 445, 7: 61, 8: 9, 11: 26, 12: 8}
"""Types in the order in which that state has them, and their lengths."""


def make_robot(version: tuple[int, int] = (5, 11)) -> Robot:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    robot = Robot(World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1), (*version, 0, 108249))
    run(robot, 0.01)
    return robot


def run(robot: Robot, duration_s: float) -> None:
    for _ in range(round(duration_s / 0.002)):
        robot.cycle(robot.time_ns + CYCLE_NS)


def packages(state: bytes) -> dict[int, bytes]:
    """The parts of a robot state by type, without their heads."""
    assert struct.unpack_from(">iB", state) == (len(state), 16)
    parts, at = {}, 5
    while at < len(state):
        size, kind = struct.unpack_from(">iB", state, at)
        parts[kind] = state[at + 5 : at + size]
        at += size
    return parts


def test_the_arm_stands_and_carries_as_urs_own_does() -> None:
    flange = forward(UR_JOINTS)
    assert to_ur(flange) == pytest.approx(UR_POSE, abs=1e-9)
    assert dexterity(Body(UR_JOINTS)) == pytest.approx(UR_DEXTERITY, rel=1e-9)
    currents = loads.joint_currents(loads.joint_torques(UR_JOINTS, flange, 0.0, (0.0, 0.0, 0.0)))
    assert currents == pytest.approx(UR_CURRENTS_A, rel=0.03, abs=0.002)


def test_a_state_has_the_packages_of_an_e_series_controller() -> None:
    parts = packages(robot_state(make_robot()))
    assert {kind: len(body) + 5 for kind, body in parts.items()} == PACKAGES
    assert list(parts) == list(PACKAGES)


def test_what_a_state_says_is_what_the_data_exchange_says() -> None:
    robot = make_robot()
    robot.load(1.5, (0.0, 0.0, 0.1))
    run(robot, 0.1)
    get, parts = robot.bank.get, packages(robot_state(robot))
    rows = [struct.unpack_from(">3d4fB", parts[1], 41 * i) for i in range(6)]
    assert [row[0] for row in rows] == list(get("actual_q"))  # type: ignore[arg-type]
    assert [row[3] for row in rows] == pytest.approx(get("actual_current"))
    assert {row[7] for row in rows} == {253}
    assert struct.unpack(">12d", parts[4]) == (*get("actual_TCP_pose"), *get("tcp_offset"))  # type: ignore[misc]
    assert struct.unpack(">7d", parts[7])[:6] == get("actual_TCP_force")
    assert struct.unpack_from(">Q", parts[0])[0] == robot.time_ns // 1000


def test_modes_stops_and_programs_show() -> None:
    robot = make_robot()

    def flags() -> tuple[object, ...]:
        return struct.unpack_from(">7?B", packages(robot_state(robot))[0], 8)

    assert flags() == (True, True, True, False, False, False, False, RobotMode.RUNNING)
    robot.run(ScriptRun(robot, ScriptProgram("nap", ("sleep(1)",))))
    run(robot, 0.01)
    assert flags()[5:7] == (True, False)
    robot.paused = True
    assert flags()[5:7] == (True, True)
    robot.paused = False
    robot.protective_stop()
    run(robot, 0.01)
    assert flags()[3:6] == (False, True, False)
    assert packages(robot_state(robot))[3][60] == 3, "the masterboard's safety mode"
    robot.safety.emergency_stop()
    run(robot, 0.01)
    assert flags() == (True, True, False, True, False, False, False, RobotMode.POWER_OFF)


def test_the_version_comes_first() -> None:
    message = version_message(make_robot())
    size, kind, _, source, what = struct.unpack_from(">iBQbB", message)
    assert (size, kind, source, what) == (len(message), 20, -2, 3)
    assert message[15:25] == b"\x09URControl"
    assert struct.unpack_from(">BBii", message, 25) == (5, 11, 0, 108249)


@pytest.mark.parametrize(
    ("version", "size"), [((5, 3), 1108), ((5, 4), 1116), ((5, 9), 1116), ((5, 10), 1220)]
)
def test_the_realtime_state_has_its_versions_length(version: tuple[int, int], size: int) -> None:
    state = realtime_state(make_robot(version))
    assert (len(state), *struct.unpack_from(">i", state)) == (size, size)


def test_the_realtime_state_has_everything_where_the_guide_has_it() -> None:
    """The guide numbers the values from 1, after the message's size."""
    robot = make_robot((5, 11))
    robot.load(1.5, (0.0, 0.01, 0.1))
    robot.io.set_digital(4, 4)
    run(robot, 0.02)
    state = (0.0, *struct.unpack(">152d", realtime_state(robot)[4:]))
    for name, first in {
        "timestamp": 1, "target_q": 2, "target_moment": 26, "actual_q": 32, "actual_TCP_pose": 56,
        "actual_TCP_force": 68, "target_TCP_pose": 74, "joint_temperatures": 87, "robot_mode": 95,
        "joint_mode": 96, "safety_mode": 102, "actual_tool_accelerometer": 109, "speed_scaling": 118,
        "actual_main_voltage": 122, "actual_joint_voltage": 125, "actual_digital_output_bits": 131,
        "runtime_state": 132, "elbow_position": 133, "elbow_velocity": 136, "safety_status": 139,
        "payload": 143, "payload_cog": 144, "payload_inertia": 147,
    }.items():  # fmt: skip
        value = robot.bank.get(name)
        wanted = value if isinstance(value, tuple) else (value,)
        assert state[first : first + len(wanted)] == wanted, name


def test_the_elbow_moves_as_it_is_said_to() -> None:
    joints, speeds = (0.3, -1.2, 1.0, -1.4, 1.5, 0.2), (0.4, -0.3, 0.5, 0.0, 0.0, 0.0)
    step = 1e-6
    after = tuple(q + step * v for q, v in zip(joints, speeds, strict=True))
    here, there = loads.elbow_position(joints), loads.elbow_position(after)  # type: ignore[arg-type]
    measured = [(b - a) / step for a, b in zip(here, there, strict=True)]
    assert loads.elbow_velocity(joints, speeds) == pytest.approx(measured, abs=1e-5)


def test_torques_are_the_slope_of_the_arms_potential_energy() -> None:
    def height_energy(joints: Vector6) -> float:
        q2, q3, q4 = joints[1:4]
        flange = forward(joints)
        elbow = -0.425 * math.sin(q2)
        wrist = elbow - 0.3922 * math.sin(q2 + q3)
        return loads.GRAVITY_M_S2 * (
            loads.UPPER_ARM_KG * (-0.2125 * math.sin(q2))
            + loads.FOREARM_KG * (elbow - 0.2422 * math.sin(q2 + q3))
            + loads.WRIST_1_KG * wrist
            + loads.WRIST_2_KG * (wrist - 0.0997 * math.cos(q2 + q3 + q4))
            + loads.FLANGE_KG * flange[2]
        )

    joints: Vector6 = (0.0, -1.2, 1.0, -1.4, math.pi / 2, 0.2)
    torques = loads.joint_torques(joints, forward(joints), 0.0, (0.0, 0.0, 0.0))
    for joint in (1, 2, 3):
        ahead = list(joints)
        ahead[joint] += 1e-6
        slope = (height_energy(tuple(ahead)) - height_energy(joints)) / 1e-6  # type: ignore[arg-type]
        assert torques[joint] == pytest.approx(slope, abs=1e-3)


def test_the_raw_wrench_is_in_the_flanges_axes_with_all_that_hangs_there() -> None:
    robot = make_robot()
    robot.load(2.0, (0.0, 0.0, 0.1))
    robot.zero_force_sensor()
    run(robot, 0.01)
    force = robot.bank.get("ft_raw_wrench")[2]  # type: ignore[index]
    assert force == pytest.approx(2.0 * loads.GRAVITY_M_S2, abs=4.0), "the tool points down"
    assert abs(robot.bank.get("actual_TCP_force")[2]) < 1.0  # type: ignore[index]
