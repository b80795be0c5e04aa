"""Programs on the script ports: where one ends, which kind it is, and what programs of others do."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.wire.ur import script as ur_script
from fakes.wire.ur.control_loop import ControlLoop
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.script import ProgramReader, register_offset, run_other
from fakes.world.world import BenchLayout, World

CONTROL = """def rtde_control():
    global reg_offset_float = # float register offset
{offset}    global reg_offset_int = # int register offset
{offset}    global force_mode_type = 2
    while True:
        sync()
    end
end
"""


@pytest.fixture
def robot() -> Robot:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    return Robot(World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1), (5, 11, 0, 0))


def run(robot: Robot, line: str, cycles: int) -> None:
    """Start a program of one line and run the controller."""
    assert robot.run(run_other(robot, f"def other():\n  {line}\nend"))
    go_on(robot, cycles)


def go_on(robot: Robot, cycles: int) -> None:
    for _ in range(cycles):
        robot.cycle(robot.time_ns + CYCLE_NS)


@pytest.mark.parametrize("offset", [0, 24])
def test_control_program_is_recognised_with_its_offset(offset: int) -> None:
    assert register_offset(CONTROL.format(offset=offset)) == offset
    assert register_offset("movej([0,0,0,0,0,0])") is None


@pytest.mark.parametrize("step", [1, 7, 4096])
def test_programs_are_split_however_they_arrive(step: int) -> None:
    texts = [
        CONTROL.format(offset=0),
        "movej([0,0,0,0,0,0])\n",
        "def f():\nif True:\nsync()\nend\nend\n",
    ]
    stream, reader, seen = "".join(texts).encode(), ProgramReader(), []
    for start in range(0, len(stream), step):
        seen += reader.feed(stream[start : start + step])
    assert [text + "\n" for text in seen] == texts


def test_program_without_end_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur_script, "LONGEST_PROGRAM", 1000)
    reader = ProgramReader()
    reader.feed(b"def f():\n")
    with pytest.raises(InputError, match="does it end"):
        reader.feed(b" sync()\n" * 1000)


def test_program_of_others_moves_and_ends(robot: Robot) -> None:
    run(robot, "movel(p[0.45, 0.05, 0.25, 3.14159265, 0, 0], a=1.2, v=0.5)", 500)
    assert np.allclose(robot.body.tcp[:3], (0.45, 0.05, 0.25), atol=1e-6)
    assert (robot.runtime.running, robot.runtime.last_error) == (False, "ended")


@pytest.mark.parametrize(
    "line",
    [
        "movel(p[1, 2], a=1, v=1)",
        "movel(p[3, 0, 0, 0, 0, 0], a=1, v=1)",
        "movel(p[1e400, 0, 0, 0, 0, 0], a=1, v=1)",
        "movel(p[0.45, 0, 0.25, 3.14, 0, 0], a=x, v=1)",
        "sleep('long')",
        "sleep(1e999)",
    ],
)
def test_invalid_line_ends_the_program(robot: Robot, line: str) -> None:
    run(robot, line, cycles=5)
    assert not robot.runtime.running
    assert robot.runtime.last_error not in ("", "ended")


def test_program_starts_once_it_has_been_read(robot: Robot) -> None:
    """ur-rtde's takes about 40 ms; until then nothing runs, or still the program before."""
    assert robot.run(ControlLoop(robot).run(), characters=42_000)
    go_on(robot, 20)
    assert (robot.bank.get("runtime_state"), robot.bank.get("output_int_register_0")) == (1, 0)
    go_on(robot, 2)
    assert (robot.bank.get("runtime_state"), robot.bank.get("output_int_register_0")) == (2, 1)
    assert robot.run(ControlLoop(robot).run(), characters=42_000)
    assert robot.runtime.running
    robot.end_program("stopped")
    go_on(robot, 100)
    assert not robot.runtime.running, "the program that was being read is discarded, too"


def test_program_that_replaces_a_moving_one_moves(robot: Robot) -> None:
    run(robot, "movel(p[0.45, 0, 0.2, 3.14159265, 0, 0], a=1, v=0.1)", cycles=50)
    robot.run(run_other(robot, "movel(p[0.45, 0, 0.35, 3.14159265, 0, 0], a=2, v=0.5)"), characters=100)
    go_on(robot, 500)
    assert robot.body.tcp[2] == pytest.approx(0.35, abs=1e-6)
