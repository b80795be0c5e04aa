"""The answers of the simulated dashboard, worded as ur-rtde's DashboardClient checks them."""

import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.wire.ur.dashboard import LineReader, reply
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.world.world import BenchLayout, World


@pytest.fixture
def robot() -> Robot:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    return Robot(World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1), (5, 11, 0, 108249))


def ask(robot: Robot, request: str) -> str:
    return reply(robot, "20265500001", request)


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("PolyscopeVersion", "URSoftware 5.11.0.108249 (Jun 30 2021)"),
        ("get serial number", "20265500001"),
        ("is in remote control", "true"),
        ("running", "Program running: false"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("stop", "Stopped"),
        ("POWER ON", "Powering on"),
        ("make tea", 'could not understand: "make tea"'),
    ],
)
def test_replies(robot: Robot, request_: str, answer: str) -> None:
    assert ask(robot, request_) == answer


def test_protective_stop_is_released_after_five_seconds_only(robot: Robot) -> None:
    robot.protective_stop()
    robot.cycle(4_900_000_000 // CYCLE_NS * CYCLE_NS)
    assert ask(robot, "unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    robot.cycle(5_100_000_000 // CYCLE_NS * CYCLE_NS)
    assert ask(robot, "unlock protective stop") == "Protective stop releasing"
    assert ask(robot, "safetymode") == "Safetymode: NORMAL"


def test_emergency_stop_leaves_the_power_off_until_the_brakes_are_released(robot: Robot) -> None:
    robot.safety.emergency_stop()
    assert ask(robot, "brake release").startswith("Failed")
    robot.safety.release_button()
    assert ask(robot, "robotmode") == "Robotmode: POWER_OFF"
    ask(robot, "power on")
    assert not robot.safety.may_move
    ask(robot, "brake release")
    assert robot.safety.may_move


@pytest.mark.parametrize("step", [1, 5, 100])
def test_lines_are_split_however_they_arrive(step: int) -> None:
    stream, reader, seen = b"running\nsafetymode\nrobotmode", LineReader(), []
    for start in range(0, len(stream), step):
        seen += reader.feed(stream[start : start + step])
    assert seen == ["running", "safetymode"]


def test_line_without_end_is_rejected() -> None:
    with pytest.raises(InputError, match="line of more than"):
        LineReader().feed(b"x" * 10_000)
