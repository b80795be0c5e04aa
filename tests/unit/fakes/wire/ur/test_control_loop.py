"""The emulated control program: registers, motions and stops, one cycle at a time, without sockets."""

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.wire.ur.control_loop import DONE, READY, ControlLoop
from fakes.wire.ur.geometry import to_ur
from fakes.wire.ur.robot import CYCLE_NS, CYCLE_S, Robot
from fakes.world.world import BenchLayout, World

MOVE_L, SERVO_J = 3, 11
DOWN = Rotation.from_euler("x", 180, degrees=True)
HOME = (0.45, 0.0, 0.30)


class Rig:
    """A controller that runs the control program, and access to its registers as a client has it."""

    def __init__(self, offset: int = 0) -> None:
        world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), Pose.from_rotation(HOME, DOWN)), seed=1)
        self.robot = Robot(world, (5, 11, 0, 0))
        self.offset = offset
        self.cycles = itertools.count(1)
        self.upload()

    def upload(self) -> bool:
        started = self.robot.run(ControlLoop(self.robot, self.offset).run())
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
        """Send a command and wait until it is done, as the client does; return the number of cycles."""
        self.send(command, doubles, integer)
        cycles = 0
        while cycles < 5000 and self.robot.runtime.running and (not cycles or self.integer(0) != DONE):
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


@pytest.fixture
def rig() -> Rig:
    return Rig()


def above(height_m: float) -> tuple[float, ...]:
    return (0.45, 0.0, HOME[2] + height_m, math.pi, 0.0, 0.0)


@pytest.mark.parametrize("offset", [0, 24])
def test_linear_move_is_done_on_arrival(offset: int) -> None:
    rig = Rig(offset=offset)
    took_s = rig.call(MOVE_L, (*above(0.1), 0.25, 1.0), 0) * CYCLE_S
    assert np.allclose(rig.pose[:3], above(0.1)[:3], atol=1e-9)
    assert took_s == pytest.approx(0.25 / 1.0 + 0.1 / 0.25, abs=0.01), "trapezoid: v/a + s/v"
    assert rig.integer(0) == READY


def test_command_is_executed_once_until_it_is_cleared(rig: Rig) -> None:
    rig.send(8)
    rig.run(5)
    assert rig.robot.commands[8] == 1
    assert rig.integer(0) == DONE
    rig.send(0)
    rig.run(1)
    assert rig.integer(0) == READY


def test_tcp_and_payload_are_stored(rig: Rig) -> None:
    rig.call(29, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    assert rig.pose[2] == pytest.approx(HOME[2] + 0.18)
    rig.call(40)
    assert rig.answer()[2] == pytest.approx(0.1)
    rig.call(17, (1.5, 0.0, 0.0, 0.05))
    rig.call(17, (1.6, 0.0, 0.0, 0.0))
    assert rig.robot.bank.get("payload") == 1.6
    assert rig.robot.bank.get("payload_cog") == (0.0, 0.0, 0.05), "a centre of zero keeps the old one"


def test_watchdog_ends_program_without_writes(rig: Rig) -> None:
    rig.call(35, (10.0,))
    for _ in range(10):
        rig.send(0)
        rig.run(40)
    assert rig.robot.runtime.running
    rig.run(60)
    assert not rig.robot.runtime.running


def test_protective_stop_brakes_ends_program_and_blocks_uploads(rig: Rig) -> None:
    rig.call(MOVE_L, (*above(0.2), 0.2, 2.0), 1)
    rig.run(100)
    rig.robot.protective_stop()
    rig.run(50)
    assert rig.robot.body.twist == (0.0,) * 6
    assert not rig.robot.runtime.running
    assert rig.robot.bank.get("safety_status_bits") == 0x404
    assert rig.robot.bank.get("safety_mode") == 3
    assert not rig.robot.safety.unlock(rig.robot.time_ns)
    assert not rig.upload()
    rig.run(2500)
    assert rig.robot.safety.unlock(rig.robot.time_ns)
    assert rig.upload()


@pytest.mark.parametrize(("command", "reason"), [(MOVE_L, "no inverse"), (SERVO_J, "command 11 of ur-rtde")])
def test_pose_out_of_reach_or_unknown_command_ends_the_program(rig: Rig, command: int, reason: str) -> None:
    rig.call(command, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 1.0), 0)
    assert not rig.robot.runtime.running
    assert reason in rig.robot.runtime.last_error
    assert rig.upload()
