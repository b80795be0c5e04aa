"""Programs on the script ports: where one ends, which kind it is, and what a user's own one does."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.wire.ur import script as ur_script
from fakes.wire.ur.interpreter import ScriptRun
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.script import ControlProgram, ProgramReader, ScriptProgram, recognise
from fakes.world.world import BenchLayout, World

CONTROL = """def rtde_control():
    global reg_offset_float = # float register offset
{offset}    global reg_offset_int = # int register offset
{offset}    global force_mode_type = 2
    def exec_move_path():
        textmsg("exec_move_path")
        # inject move path
{path}    end
    while True:
        sync()
    end
end
"""
PATH = """\tsignal_async_progress(0)
\tmovej([0.1,-1.5,1.2,-1,1.5,0],a=1.4,v=1.05,r=0)
\tsignal_async_progress(1)
\tmovel(p[0.4,0,0.3,3.14,0,0],a=1.2,v=0.25,r=0.02)
"""


@pytest.fixture
def robot() -> Robot:
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    return Robot(World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1), (5, 11, 0, 0))


def run(robot: Robot, script: str, most_cycles: int = 2000) -> ScriptRun:
    """Run a user's program to its end."""
    program = recognise(script)
    assert isinstance(program, ScriptProgram)
    started = ScriptRun(robot, program)
    assert robot.run(started)
    for cycle in range(1, most_cycles):
        robot.cycle(cycle * CYCLE_NS)
        if not robot.running:
            break
    return started


@pytest.mark.parametrize("offset", [0, 24])
def test_the_control_program_is_recognised_with_its_offset_and_path(offset: int) -> None:
    program = recognise(CONTROL.format(offset=offset, path=PATH))
    assert isinstance(program, ControlProgram)
    assert program.offset == offset
    first, second = program.path
    assert (first.function, first.is_pose, first.speed, first.acceleration) == ("movej", False, 1.05, 1.4)
    assert (second.function, second.is_pose, second.values[2]) == ("movel", True, 0.3)


def test_a_program_without_a_path_has_none() -> None:
    program = recognise(CONTROL.format(offset=0, path=""))
    assert program == ControlProgram(0, ())


@pytest.mark.parametrize("values", ["1,2,3", "1,2,3,4,5,x"])
def test_a_path_that_is_no_motion_is_refused(values: str) -> None:
    with pytest.raises(InputError, match="movej"):
        recognise(CONTROL.format(offset=0, path=f"\tmovej([{values}],a=1,v=1,r=0)\n"))


@pytest.mark.parametrize("step", [1, 7, 4096])
def test_programs_are_cut_at_their_own_end_however_they_arrive(step: int) -> None:
    texts = [
        CONTROL.format(offset=0, path=PATH),
        "movej([0,0,0,0,0,0])\n",
        "def f():\nif True:\nsync()\nend\nend\n",
    ]
    stream, reader, seen = "".join(texts).encode(), ProgramReader(), []
    for start in range(0, len(stream), step):
        seen += reader.feed(stream[start : start + step])
    assert [text + "\n" for text in seen] == texts


def test_a_program_that_never_ends_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur_script, "LONGEST_PROGRAM", 1000)
    reader = ProgramReader()
    reader.feed(b"def f():\n")
    with pytest.raises(InputError, match="does it end"):
        reader.feed(b" sync()\n" * 1000)


def test_a_users_program_moves_and_writes(robot: Robot) -> None:
    there = run(
        robot,
        "def mine():\n  target = p[0.45, 0.05, 0.25, 3.14159265, 0, 0]\n  movel(target, a=1.2, v=0.5)\n"
        "  set_standard_digital_out(3, True)\n  write_output_integer_register(12 + 1, 7)\nend",
    )
    assert not there.skipped
    assert np.allclose(robot.body.tcp[:3], (0.45, 0.05, 0.25), atol=1e-6)
    assert robot.bank.get("actual_digital_output_bits") == 8
    assert robot.bank.get("output_int_register_13") == 7


def test_sleep_takes_its_time(robot: Robot) -> None:
    run(robot, "def nap():\n  sleep(0.1)\nend")
    assert robot.time_ns == pytest.approx(0.1e9, abs=2 * CYCLE_NS)


def test_what_is_not_understood_is_skipped_and_said(robot: Robot) -> None:
    assert run(robot, "def odd():\n  while True:\n  dance(3)\n  x = 1\nend").skipped == [
        "while True:",
        "dance(3)",
    ]


@pytest.mark.parametrize(
    "line", ["movej([1, 2], a=1, v=1)", "movel(p[3, 0, 0, 0, 0, 0])", "sleep('long')", "halt()"]
)
def test_an_error_ends_a_program(robot: Robot, line: str) -> None:
    run(robot, f"def broken():\n  {line}\n  sleep(100)\nend", most_cycles=5)
    assert not robot.running
    assert robot.last_error not in ("", "ended")
