"""A lift over the wire protocol continues whatever happens to the page that shows it.

The page alone: `tests/unit/rig/test_watch.py`.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.config import BenchConfig
from rig.config.write import write_bench
from rig.sessions.rows import read_finished_lifts
from support.slow_motion import IN_SLOW_MOTION
from support.waiting import LIMIT_S, until

pytestmark = pytest.mark.heavy


@pytest.fixture
def wire_file(tmp_path: Path, unhurried_bench: BenchConfig) -> Path:
    write_bench(tmp_path / "bench.toml", unhurried_bench)
    return tmp_path / "bench.toml"


@contextmanager
def watched_trial(bench: Path, out: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Start a trial of one lift with a page; give its process and the page's address."""
    program = f"{IN_SLOW_MOTION}from rig.cli.main import main; main()"
    words = ["trial", "--lifts", "1", "--object", "wrench", "--no-report", "--yes", "--watch"]
    command = [sys.executable, "-c", program, *words, "--bench", str(bench), "--out", str(out)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        lines = iter(process.stderr.readline, "")
        yield process, next(line for line in lines if "watch page: " in line).split()[-1]


def finish(process: "subprocess.Popen[str]", out: Path) -> None:
    _, error = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, error
    (row,) = read_finished_lifts(out)
    assert row.attempt == 0, "no attempt before it ended as a fault"


def test_stopped_page_does_not_disturb_a_lift(wire_file: Path, tmp_path: Path) -> None:
    with watched_trial(wire_file, tmp_path / "s") as (process, _):
        until(lambda: page_of(process.pid) is not None)
        page = page_of(process.pid)
        assert page is not None
        os.kill(page, signal.SIGSTOP)
        finish(process, tmp_path / "s")
    assert not Path(f"/proc/{page}").exists()


def page_of(pid: int) -> int | None:
    """Return the process of a command's page: its child with a lower priority."""
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        if os.getpriority(os.PRIO_PROCESS, int(child)) > os.getpriority(os.PRIO_PROCESS, pid):
            return int(child)
    return None
