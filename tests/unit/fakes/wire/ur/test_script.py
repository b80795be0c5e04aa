"""Programs on the script ports: where one ends, which kind it is, and what a user's own one does."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from drivers.types import Pose
from fakes.wire.ur import script as ur_script
from fakes.wire.ur.commands import COMMANDS
from fakes.wire.ur.control_loop import ControlLoop
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.script import ControlProgram, ProgramReader, ScriptProgram, recognise
from fakes.wire.ur.user_programs.run import ScriptRun
from fakes.wire.ur.user_programs.statements import parse_statements
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
    text = "def odd():\n  thread aside():\n    halt()\n  end\n  dance(3)\n  dance(3)\n  x = 1\nend"
    assert run(robot, text).skipped == ["thread aside():", "dance(3)"]
    assert robot.last_error == "ended"


@pytest.mark.parametrize(
    "line", ["movej([1, 2], a=1, v=1)", "movel(p[3, 0, 0, 0, 0, 0])", "sleep('long')", "halt()"]
)
def test_an_error_ends_a_program(robot: Robot, line: str) -> None:
    run(robot, f"def broken():\n  {line}\n  sleep(100)\nend", most_cycles=5)
    assert not robot.running
    assert robot.last_error not in ("", "ended")


def test_branches_and_loops_are_carried_out(robot: Robot) -> None:
    there = run(
        robot,
        """def count():
  values = [0, 0, 0]
  i = 0
  while i < 3:
    if i == 0 and not False:
      values[i] = 10
    elif i == 1 or 1 > 2:
      values[i] = 20 % 7
    else:
      values[i] = values[0] / 4
    end
    write_output_float_register(i, values[i])
    i = i + 1
  end
  global done = p[0, 0, 0, 0, 0, 0] != p[0, 0, 0, 0, 0, 1]
  if done:
    write_output_integer_register(0, i)
  end
end""",
    )
    assert not there.skipped
    assert [robot.bank.get(f"output_double_register_{i}") for i in range(3)] == [10.0, 6.0, 2.5]
    assert robot.bank.get("output_int_register_0") == 3


def test_a_loop_that_waits_for_nothing_does_not_hold_up_the_controller(robot: Robot) -> None:
    started = run(robot, "def busy():\n  x = 0\n  while True:\n    x = x + 1\n  end\nend", most_cycles=5)
    assert robot.running
    assert not started.skipped


def test_a_program_follows_what_the_data_exchange_writes(robot: Robot) -> None:
    """As UR's control loop example has it: a register says go, another says done."""
    text = """def follow():
  write_output_integer_register(0, 1)
  while True:
    if read_input_integer_register(0) == 1:
      movel(p[read_input_float_register(0), 0, 0.25, 3.14159265, 0, 0], a=2, v=0.5)
      write_output_integer_register(0, 0)
      while read_input_integer_register(0) == 1:
        sync()
      end
      write_output_integer_register(0, 1)
    end
    sync()
  end
end"""
    run(robot, text, most_cycles=5)
    assert robot.bank.get("output_int_register_0") == 1
    robot.write_inputs({"input_double_register_0": 0.4})
    robot.write_inputs({"input_int_register_0": 1})
    on(robot, 1000)
    assert robot.body.tcp[:3] == pytest.approx((0.4, 0.0, 0.25), abs=1e-6)
    assert robot.bank.get("output_int_register_0") == 0
    robot.write_inputs({"input_int_register_0": 0})
    on(robot, 5)
    assert robot.bank.get("output_int_register_0") == 1


@pytest.mark.parametrize(("action", "state"), [("PAUSE", 4), ("STOP", 1), ("IGNORE", 2)])
def test_a_watchdog_does_what_it_was_told_to(robot: Robot, action: str, state: int) -> None:
    run(robot, f'def f():\n rtde_set_watchdog("input_int_register_0", 10, "{action}")\n sleep(9)\nend', 5)
    on(robot, 40)
    assert robot.bank.get("runtime_state") == 2
    on(robot, 40)
    assert robot.bank.get("runtime_state") == state


def test_a_speed_is_kept_for_its_time_and_braked_after_it(robot: Robot) -> None:
    run(robot, "def f():\n speedl([0, 0, 0.05, 0, 0, 0], a=1.0, t=0.5)\nend", most_cycles=200)
    assert robot.bank.get("actual_TCP_speed")[2] == pytest.approx(0.05)  # type: ignore[index]
    on(robot, 400)
    assert not robot.running
    assert robot.body.twist == (0.0,) * 6
    assert robot.body.acceleration == robot.body.qdd == (0.0,) * 6


def test_a_program_starts_when_it_has_been_read_and_says_so_then(robot: Robot) -> None:
    """ur-rtde's takes some 40 ms, in which nothing runs, or still what ran before."""
    program = ControlLoop(robot, ControlProgram(0, ()), COMMANDS)
    assert robot.run(program, characters=42_000)
    on(robot, 20)
    assert (robot.bank.get("runtime_state"), robot.bank.get("output_int_register_0")) == (1, 0)
    on(robot, 2)
    assert (robot.bank.get("runtime_state"), robot.bank.get("output_int_register_0")) == (2, 1)
    assert robot.run(ControlLoop(robot, ControlProgram(0, ()), COMMANDS), characters=42_000)
    assert robot.running
    robot.end_program("stopped")
    on(robot, 100)
    assert not robot.running, "what was being read is forgotten, too"


@pytest.mark.parametrize(
    "line",
    [
        "x = " + "-" * 4000 + "1",
        "x = [0] * 1000000000",
        "x = 'a' * 1000000000",
        "x = [[0], [0]]",
        "write_output_integer_register(0, 1e300)",
        "write_output_integer_register(0, 'one')",
        "set_standard_digital_out(1e400, True)",
        "set_tcp(p[1e300, 1e300, 0, 1e300, 0, 0])",
        "speedl([1e308, 0, 0, 1e308, 0, 0], 1e308, 1)",
        "movej([1e308, 0, 0, 0, 0, 0])",
        "set_payload(1e400, 3)",
        "set_standard_digital_out(2147483648, True)",
        "set_standard_digital_out(-1, True)",
        "speedj([0, 0, 0, 0, 0, 0], 'x')",
        "speedl(['x', 0, 0, 0, 0, 0], 1)",
        "sleep(1e999 - 1e999)",
        "x = y.z(1)",
        "rtde_set_watchdog('input_int_register_99', 1)",
        "rtde_set_watchdog('input_int_register_0', 5e-324)",
    ],
)
def test_whatever_a_program_says_the_controller_goes_on(robot: Robot, line: str) -> None:
    run(robot, f"def odd():\n  {line}\n  sleep(0.01)\nend", most_cycles=20)
    on(robot, 10)
    assert robot.time_ns > 0
    assert robot.safety.robot_mode == 7


def test_whole_numbers_stay_within_32_bits(robot: Robot) -> None:
    run(robot, "def grow():\n  x = 3\n  while True:\n    x = x * x\n  end\nend", most_cycles=20)
    assert "beyond 32 bits" in robot.last_error


def test_blocks_may_be_nested_only_so_deep() -> None:
    depth = 60
    text = "def f():\n" + "if True:\n" * depth + "sync()\n" + "end\n" * depth + "end"
    program = recognise(text)
    assert isinstance(program, ScriptProgram)
    with pytest.raises(InputError, match="nested deeper"):
        parse_statements(program.lines)


def test_a_program_that_takes_anothers_place_moves(robot: Robot) -> None:
    run(robot, "def first():\n movel(p[0.45, 0, 0.2, 3.14159265, 0, 0], a=1, v=0.1)\nend", most_cycles=50)
    second = recognise("def second():\n movel(p[0.45, 0, 0.35, 3.14159265, 0, 0], a=2, v=0.5)\nend")
    assert isinstance(second, ScriptProgram)
    robot.run(ScriptRun(robot, second), characters=100)
    on(robot, 500)
    assert robot.body.tcp[2] == pytest.approx(0.35, abs=1e-6)


def on(robot: Robot, cycles: int) -> None:
    """Let the controller run on."""
    for _ in range(cycles):
        robot.cycle(robot.time_ns + CYCLE_NS)
