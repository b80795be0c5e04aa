"""Programs on the script ports: where one ends, which kind it is, and what programs of others do."""

import pytest

from fakes.wire.ur.control_loop import ControlLoop
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.script import run_other
from support.worlds import empty_world


@pytest.fixture
def robot() -> Robot:
    return Robot(empty_world(), (5, 11, 0, 0))


def run(robot: Robot, line: str, cycles: int) -> None:
    """Start a program of one line and run the controller."""
    assert robot.run(run_other(robot, f"def other():\n  {line}\nend"))
    go_on(robot, cycles)


def go_on(robot: Robot, cycles: int) -> None:
    for _ in range(cycles):
        robot.cycle(robot.time_ns + CYCLE_NS)


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
