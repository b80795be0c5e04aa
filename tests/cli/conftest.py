"""What commands are tried on: a trial of one lift, made once (copy it to write into it), and a terminal."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.command_line import rig
from support.terminal import Terminal


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory, light_bench_file: Path) -> Path:
    """A trial of one lift of the toothbrush on the light bench, without a report."""
    folder = tmp_path_factory.mktemp("one_lift") / "session"
    what = ("--lifts", 1, "--object", "toothbrush", "--bench", light_bench_file, "--jobs", 1, "--no-report")
    done = rig("trial", *what, "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def at_terminal() -> Iterator[Callable[[list[str], int], Terminal]]:
    """Runs a command at a terminal of so many columns: `at_terminal(command, columns)`."""
    running: list[Terminal] = []

    def run(command: list[str], columns: int) -> Terminal:
        running.append(Terminal(command, columns))
        return running[-1]

    yield run
    for terminal in running:
        terminal.close()
