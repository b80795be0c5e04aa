"""The emulated control program: registers, motions and stops, cycle by cycle without sockets or time."""

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.wire.ur.commands import COMMANDS
from fakes.wire.ur.control_loop import DONE, READY, STOP_SCRIPT, ControlLoop
from fakes.wire.ur.frames import to_ur
from fakes.wire.ur.robot import CYCLE_NS, CYCLE_S, Robot
from fakes.wire.ur.script import ControlProgram
from fakes.world.world import BenchLayout, World

MOVE_J, MOVE_L, STOP_L, SERVO_J, SPEED_L = 1, 3, 33, 11, 10
DOWN = Rotation.from_euler("x", 180, degrees=True)
HOME = (0.45, 0.0, 0.30)


class Rig:
    """A controller that runs the control program, and a client's hands on its registers."""

    def __init__(self, version: tuple[int, int, int, int] = (5, 11, 0, 0), offset: int = 0) -> None:
        self.world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), Pose.from_rotation(HOME, DOWN)), seed=1)
        self.robot = Robot(self.world, version, release_after_s=5.0)
        self.offset = offset
        self.cycles = itertools.count(1)
        self.upload()

    def upload(self, *path) -> bool:
        started = self.robot.run(ControlLoop(self.robot, ControlProgram(self.offset, path), COMMANDS))
        self.run(1)
        return started

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.robot.cycle(next(self.cycles) * CYCLE_NS)

    def send(self, command: int, doubles: tuple[float, ...] = (), integer: int | None = None) -> None:
        values: dict = {f"input_double_register_{i + self.offset}": v for i, v in enumerate(doubles)}
        if integer is not None:
            values[f"input_int_register_{1 + self.offset}"] = integer
        self.robot.write_inputs({f"input_int_register_{self.offset}": command} | values)

    def call(self, command: int, doubles: tuple[float, ...] = (), integer: int | None = None) -> int:
        """Command and wait for done, as the client does; returns the cycles it took."""
        self.send(command, doubles, integer)
        cycles = 0
        while cycles < 5000 and self.robot.running and (not cycles or self.integer(0) != DONE):
            self.run(1)
            cycles += 1
        self.send(0)
        self.run(1)
        return cycles

    def integer(self, index: int) -> int:
        return self.robot.bank.get(f"output_int_register_{index + self.offset}")  # type: ignore[return-value]

    def answer(self, count: int = 6) -> list[float]:
        return [self.robot.bank.get(f"output_double_register_{i + self.offset}") for i in range(count)]  # type: ignore[misc]

    @property
    def pose(self) -> tuple[float, ...]:
        return to_ur(self.robot.body.tcp)

    @property
    def asynchronous(self) -> tuple[int, bool]:
        """Operation and running bit of the status register."""
        return self.integer(2) >> 24, bool(self.integer(2) & 0x8000)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def above(height_m: float) -> tuple[float, ...]:
    return (0.45, 0.0, HOME[2] + height_m, math.pi, 0.0, 0.0)


def test_it_is_ready_when_it_starts(rig: Rig) -> None:
    assert rig.robot.running
    assert rig.integer(0) == READY
    assert rig.robot.bank.get("runtime_state") == 2


@pytest.mark.parametrize("offset", [0, 24])
def test_a_straight_move_is_done_when_it_has_arrived(offset: int) -> None:
    rig = Rig(offset=offset)
    took_s = rig.call(MOVE_L, (*above(0.1), 0.25, 1.0), 0) * CYCLE_S
    assert np.allclose(rig.pose[:3], above(0.1)[:3], atol=1e-9)
    assert took_s == pytest.approx(0.25 / 1.0 + 0.1 / 0.25, abs=0.01), "trapezoid: v/a + s/v"
    assert rig.integer(0) == READY


def test_the_world_follows_the_arm(rig: Rig) -> None:
    rig.call(MOVE_L, (*above(0.05), 0.25, 1.0), 0)
    now = rig.robot.time_ns
    assert np.allclose(rig.world.tool.pose_at(now).position_m, above(0.05)[:3], atol=1e-9)
    assert rig.world.tool.tilt_at(now) == pytest.approx(0.0, abs=1e-9)


def test_a_joint_move_ends_in_its_joints(rig: Rig) -> None:
    q = list(rig.robot.body.q)
    q[0] += 0.5
    rig.call(MOVE_J, (*q, 1.0, 2.0), 0)
    assert np.allclose(rig.robot.body.q, q)


def test_an_asynchronous_move_is_done_at_once_and_reports(rig: Rig) -> None:
    before, running = rig.asynchronous
    assert not running
    assert rig.call(MOVE_L, (*above(0.1), 0.1, 1.0), 1) < 5
    assert rig.asynchronous == (before + 1, True)
    rig.run(1000)
    assert rig.asynchronous == (before + 1, False)
    assert rig.pose[2] == pytest.approx(HOME[2] + 0.1)


def test_a_stop_brakes_within_one_control_cycle(rig: Rig) -> None:
    rig.call(MOVE_L, (*above(0.2), 0.2, 2.0), 1)
    rig.run(150)
    assert rig.robot.body.twist[2] == pytest.approx(0.2)
    rig.send(STOP_L, (10.0,), 1)
    rig.run(1)
    assert rig.robot.body.twist[2] < 0.2
    rig.run(20)
    assert rig.robot.body.twist[2] == 0.0
    assert not rig.asynchronous[1]
    assert HOME[2] < rig.pose[2] < HOME[2] + 0.1


def test_the_first_synchronous_stop_is_a_joint_stop(rig: Rig) -> None:
    """A quirk of ur-rtde 1.6.5: only the asynchronous branch says which kind of stop it is."""
    rig.call(MOVE_L, (*above(0.2), 0.2, 2.0), 1)
    rig.run(150)
    joint_brake_s = max(map(abs, rig.robot.body.qd)) / 0.5
    assert abs(joint_brake_s - 0.2 / 0.5) > 0.1, "the two kinds of stop differ here"
    assert rig.call(STOP_L, (0.5,), 0) * CYCLE_S == pytest.approx(joint_brake_s, abs=0.01)


def test_a_command_is_carried_out_once_until_it_is_cleared(rig: Rig) -> None:
    rig.send(8)
    rig.run(5)
    assert rig.robot.commands[8] == 1
    assert rig.integer(0) == DONE
    rig.send(0)
    rig.run(1)
    assert rig.integer(0) == READY


def test_servo_follows_and_stays_ready(rig: Rig) -> None:
    q = list(rig.robot.body.q)
    for _ in range(500):
        q[0] += 0.0005
        rig.send(SERVO_J, (*q, 0.0, 0.0, 0.002, 0.1, 300.0))
        rig.run(1)
        assert rig.integer(0) == READY
    lag_s = (q[0] - rig.robot.body.q[0]) / 0.25
    assert lag_s == pytest.approx(0.1, abs=0.03), "it lags by about its look-ahead time"


def test_speed_goes_on_until_it_is_stopped(rig: Rig) -> None:
    rig.send(SPEED_L, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.5, 0.0))
    rig.run(300)
    assert rig.robot.body.twist[2] == pytest.approx(0.05)
    rig.send(0)
    rig.run(1)
    rig.call(15, (1.0,))
    rig.run(2)
    assert rig.robot.body.twist == (0.0,) * 6


@pytest.mark.parametrize("command", [MOVE_L, 46])
def test_a_pose_out_of_reach_ends_the_program(rig: Rig, command: int) -> None:
    rig.call(command, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 1.0), 0)
    assert not rig.robot.running
    assert "inverse" in rig.robot.last_error
    assert rig.upload()


def test_limits_and_solutions_can_be_asked_for(rig: Rig) -> None:
    for command, pose, answer in (
        (36, above(0.1), 1),
        (36, (2.0,) * 6, 0),
        (60, above(0.1), 1),
        (60, (2.0,) * 6, 0),
    ):
        rig.call(command, pose)
        assert rig.integer(1) == answer
    rig.call(37, (7.0,) * 6)
    assert rig.integer(1) == 0


def test_kinematics_there_and_back(rig: Rig) -> None:
    rig.call(46, above(-0.1))
    q = rig.answer()
    rig.call(44, (*q, 0.0, 0.0, 0.28, 0.0, 0.0, 0.0))
    assert np.allclose(rig.answer()[:3], above(-0.1)[:3], atol=1e-9)


def test_tcp_and_payload_are_taken(rig: Rig) -> None:
    rig.call(29, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    assert rig.pose[2] == pytest.approx(HOME[2] + 0.18)
    rig.call(40)
    assert rig.answer()[2] == pytest.approx(0.1)
    rig.call(17, (1.5, 0.0, 0.0, 0.05))
    rig.call(17, (1.6, 0.0, 0.0, 0.0))
    assert rig.robot.bank.get("payload") == 1.6
    assert rig.robot.bank.get("payload_cog") == (0.0, 0.0, 0.05), "a centre of zero keeps the old one"


def test_the_force_sensor_can_be_zeroed(rig: Rig) -> None:
    rig.run(5)
    before = rig.robot.bank.get("actual_TCP_force")
    rig.call(8)
    after = rig.robot.bank.get("actual_TCP_force")
    assert np.linalg.norm(after[:3]) < min(0.6, float(np.linalg.norm(before[:3])))  # type: ignore[index]


def test_a_move_until_contact_ends_at_the_floor(rig: Rig) -> None:
    rig.call(51, (0.0, 0.0, -0.2, 0.0, 0.0, 0.0) + (0.0,) * 6 + (0.5,))
    assert rig.pose[2] == pytest.approx(0.0, abs=1e-3)


def test_the_watchdog_ends_a_program_nobody_feeds(rig: Rig) -> None:
    rig.call(35, (10.0,))
    for _ in range(10):
        rig.send(0)
        rig.run(40)
    assert rig.robot.running
    rig.run(60)
    assert not rig.robot.running


def test_stop_script_ends_the_program(rig: Rig) -> None:
    rig.send(STOP_SCRIPT)
    rig.run(2)
    assert not rig.robot.running
    assert rig.robot.bank.get("runtime_state") == 1


def test_a_protective_stop_brakes_ends_the_program_and_waits(rig: Rig) -> None:
    rig.call(MOVE_L, (*above(0.2), 0.2, 2.0), 1)
    rig.run(100)
    rig.robot.protective_stop()
    rig.run(50)
    assert rig.robot.body.twist == (0.0,) * 6
    assert not rig.robot.running
    assert rig.robot.bank.get("safety_status_bits") == 0x404
    assert rig.robot.bank.get("safety_mode") == 3
    assert not rig.robot.safety.unlock(rig.robot.time_ns)
    assert not rig.upload()
    rig.run(2500)
    assert rig.robot.safety.unlock(rig.robot.time_ns)
    assert rig.upload()


def test_jacobian_predicts_a_small_motion() -> None:
    rig = Rig(version=(5, 25, 0, 0))
    rig.send(70)
    rig.run(1)
    put = rig.robot.bank.get
    columns = [put(f"output_double_register_{i}") for i in (*range(24), *range(36, 48))]
    jacobian = np.reshape(columns, (6, 6)).T
    dq = np.array([1e-4, -2e-4, 1e-4, 5e-5, 1e-4, 0.0])
    there = rig.robot.tcp_at(tuple(np.add(rig.robot.body.q, dq)))
    assert np.allclose(np.subtract(there[:3], rig.robot.body.tcp[:3]), (jacobian @ dq)[:3], atol=1e-6)
