"""Programs that are stopped or killed at a bench over the wire protocol that counts as real.

The true motions are read from the simulated world. `rig benchmark safety` does this at random moments.
Without --all, the parts are tested: signals in `tests/cli/test_stopping.py`, the safe end and the questions
about the hand in `tests/unit/protocols`, the arm's stop in `ur5e`.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from fakes.wire.net import Control
from rig.bench.fakes_process import hosted_fakes
from rig.benchmark.wire.campaign import as_real
from rig.config import BenchConfig
from rig.config.write import write_bench
from rig.sessions.rows import read_lifts
from support.command_line import SHORT_PHASES
from support.slow_motion import SLOWNESS, pause
from support.waiting import LIMIT_S, until

pytestmark = pytest.mark.heavy
GRASP_M, ABOVE_M = 0.06, 0.16
"""Heights of the tool at the grasp and at the start of the descent."""


@dataclass(frozen=True)
class Served:
    """Running fakes, the bench file that names them, and the same one as that of a real bench."""

    control: Control
    simulated: Path
    real: Path
    programs: list["subprocess.Popen[str]"]

    def world(self) -> dict[str, Any]:
        return self.control.call("world")

    def height_m(self) -> float:
        return self.world()["tool_m"][2]


@pytest.fixture
def served(tmp_path: Path, unhurried_bench: BenchConfig) -> Iterator[Served]:
    with hosted_fakes(unhurried_bench, None, slowness=SLOWNESS) as (config, _):
        assert config.fakes.control is not None
        simulated, real = tmp_path / "simulated.toml", tmp_path / "real.toml"
        write_bench(simulated, config)
        write_bench(real, as_real(config))
        served = Served(Control(config.fakes.control), simulated, real, [])
        yield served
        for program in served.programs:
            with program:
                program.kill()


def trial(served: Served, bench: Path, out: Path, *more: str) -> "subprocess.Popen[str]":
    """A trial in a script: with --yes and without a terminal.

    What the hand holds is stored for each test alone: an earlier one may end while its hand is opening.
    """
    words = ["trial", "--lifts", "1", "--object", "wrench", "--no-report", "--yes", *more]
    program = subprocess.Popen(
        [sys.executable, "-c", SHORT_PHASES, *words, "--bench", str(bench), "--out", str(out)],
        stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "XDG_STATE_HOME": str(out.parent / "state")},
    )  # fmt: skip
    served.programs.append(program)
    return program


def wait_until(met: Callable[[], bool], process: "subprocess.Popen[str]") -> None:
    until(lambda: met() or process.poll() is not None)
    assert process.poll() is None, process.communicate()[1]


def lifting(served: Served, out: Path) -> "subprocess.Popen[str]":
    """A trial on the real bench that holds the wrench above its place."""
    served.control.call("place", object="wrench", seed=3)
    process = trial(served, served.real, out)
    wait_until(lambda: served.world()["held"] and served.height_m() > GRASP_M + 0.02, process)
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT])
def test_trial_stopped_on_its_way_down_stays_there(
    served: Served, tmp_path: Path, number: signal.Signals
) -> None:
    served.control.call("place", object="wrench", seed=3)
    process = trial(served, served.real, tmp_path / "s")
    wait_until(lambda: GRASP_M + 0.075 < served.height_m() < ABOVE_M - 0.010, process)
    process.send_signal(number)
    there = served.height_m()
    _, error = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3, error
    assert "nothing held" in error
    assert there - 0.025 < served.height_m() <= there + 0.001
    assert served.world()["tool_moving"] is False


def test_object_held_after_a_kill_is_neither_dropped_nor_moved_unasked(
    served: Served, tmp_path: Path
) -> None:
    process = lifting(served, tmp_path / "s")
    process.kill()
    process.communicate()
    pause(1.0)
    left = served.world()
    assert left["held"]

    again = trial(served, served.real, tmp_path / "s2")
    _, error = again.communicate(timeout=LIMIT_S)
    assert again.returncode == 3, error
    assert "The hand holds wrench" in error
    now = served.world()
    assert (now["held"], now["finger_counts"]) == (True, left["finger_counts"])
    assert now["tool_m"] == pytest.approx(left["tool_m"], abs=1e-4)

    # an operator who agrees, as the one of the simulated bench does, sees it set down
    last = trial(served, served.simulated, tmp_path / "s3")
    heights = []
    wait_until(lambda: heights.append(served.height_m()) or not served.world()["held"], last)
    assert heights[-1] == pytest.approx(GRASP_M, abs=0.002)
    last.send_signal(signal.SIGINT)
    _, error = last.communicate(timeout=LIMIT_S)
    assert last.returncode == 3, error


def test_resume_after_a_stop_in_the_hold_moves_nothing_before_a_person_has_placed_the_object(
    served: Served, tmp_path: Path
) -> None:
    process = lifting(served, tmp_path / "s")
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3, error
    left = served.world()
    assert left["held"] is False
    for _ in range(2):
        again = trial(served, served.real, tmp_path / "s", "--resume")
        _, error = again.communicate(timeout=LIMIT_S)
        assert again.returncode == 3, error
        assert "the last attempt was interrupted, and its object may lie anywhere: a person has" in error
        assert "continue with: rig trial" in error
        assert served.world()["tool_m"] == pytest.approx(left["tool_m"], abs=1e-4)


def test_second_object_is_not_grasped_before_a_person_has_placed_it(served: Served, tmp_path: Path) -> None:
    served.control.call("place", object="wrench", seed=3)
    process = trial(served, served.real, tmp_path / "s", "--object", "toothbrush")
    _, error = process.communicate(timeout=2 * LIMIT_S)
    assert process.returncode == 3, error
    assert "a person has to place object t2 (toothbrush): run this at a terminal, or name a feeder" in error
    assert "use --yes" not in error
    assert "continue with: rig trial" in error
    assert [row.object for row in read_lifts(tmp_path / "s")] == ["t1"]
    left = served.world()
    assert (left["held"], left["tool_moving"]) == (False, False)
    assert served.height_m() > ABOVE_M
