"""What the commands are tried on: a trial of one lift, made once; who writes into it copies it."""

from pathlib import Path

import pytest

from support.command_line import rig


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory, light_bench_file: Path) -> Path:
    """A trial of one lift of the toothbrush on the light bench, without a report."""
    folder = tmp_path_factory.mktemp("one_lift") / "session"
    what = ("--lifts", 1, "--object", "toothbrush", "--bench", light_bench_file, "--jobs", 1, "--no-report")
    done = rig("trial", *what, "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder
