"""The simulated dashboard's answers, worded as ur-rtde's DashboardClient checks them."""

import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.wire.ur.dashboard import DashboardServer, LineReader
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.safety import RobotMode
from fakes.wire.ur.script import OtherProgramRun
from fakes.world.world import BenchLayout, World


@pytest.fixture
def dashboard() -> DashboardServer:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    robot = Robot(World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1), (5, 11, 0, 108249))
    return DashboardServer(robot, "20265500001", lambda program: robot.run(OtherProgramRun(robot, program)))


def run(dashboard: DashboardServer, duration_s: float) -> None:
    robot = dashboard.robot
    for _ in range(round(duration_s / 0.002)):
        robot.cycle(robot.time_ns + CYCLE_NS)


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("PolyscopeVersion", "URSoftware 5.11.0.108249 (Jun 30 2021)"),
        ("get serial number", "20265500001"),
        ("is in remote control", "true"),
        ("running", "Program running: false"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("programState", "STOPPED <unnamed>"),
        ("stop", "Stopped"),
        ("pause", "Failed to execute: pause"),
        ("play", "Failed to execute: play"),
        ("unlock protective stop", "Protective stop releasing"),
        ("POWER ON", "Powering on"),
        ("make tea", 'could not understand: "make tea"'),
    ],
)
def test_replies(dashboard: DashboardServer, request_: str, reply: str) -> None:
    assert dashboard.reply(request_) == reply


def test_loaded_program_plays_pauses_and_stops(dashboard: DashboardServer) -> None:
    assert dashboard.reply("load grip.urp") == "Loading program: grip.urp"
    assert dashboard.reply("play") == "Starting program"
    run(dashboard, 0.01)
    assert dashboard.reply("programState") == "PLAYING grip.urp"
    assert dashboard.reply("pause") == "Pausing program"
    run(dashboard, 0.01)
    assert dashboard.robot.bank.get("runtime_state") == 4
    assert dashboard.reply("play") == "Starting program"
    assert dashboard.reply("stop") == "Stopped"
    assert dashboard.reply("running") == "Program running: false"


def test_local_control_refuses_play(dashboard: DashboardServer) -> None:
    dashboard.reply("load grip.urp")
    dashboard.robot.safety.remote_control = False
    assert dashboard.reply("play") == "Failed to execute: play"
    assert dashboard.reply("is in remote control") == "false"


def test_protective_stop_is_released_after_five_seconds_only(dashboard: DashboardServer) -> None:
    dashboard.robot.protective_stop()
    run(dashboard, 4.9)
    assert dashboard.reply("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert dashboard.reply("unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    run(dashboard, 0.2)
    assert dashboard.reply("unlock protective stop") == "Protective stop releasing"
    assert dashboard.reply("safetystatus") == "Safetystatus: NORMAL"


def test_power_comes_step_by_step_after_an_emergency_stop(dashboard: DashboardServer) -> None:
    safety = dashboard.robot.safety
    safety.emergency_stop()
    assert dashboard.reply("power on").startswith("Failed")
    safety.release_button()
    seen = [safety.robot_mode]
    dashboard.reply("power on")
    for _ in range(25):
        run(dashboard, 0.1)
        seen.append(safety.robot_mode)
    assert sorted(set(seen)) == [RobotMode.POWER_OFF, RobotMode.POWER_ON, RobotMode.IDLE]
    assert not safety.may_move
    dashboard.reply("brake release")
    run(dashboard, 1.1)
    assert safety.may_move


@pytest.mark.parametrize("step", [1, 5, 100])
def test_lines_are_split_however_they_arrive(step: int) -> None:
    stream, reader, seen = b"running\nsafetymode\nrobotmode", LineReader(), []
    for start in range(0, len(stream), step):
        seen += reader.feed(stream[start : start + step])
    assert seen == ["running", "safetymode"]


def test_line_without_end_is_rejected() -> None:
    with pytest.raises(InputError, match="line of more than"):
        LineReader().feed(b"x" * 10_000)
