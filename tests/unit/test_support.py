"""How the suite runs: one process with hardware, several workers without."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from support.side_by_side import pytest_xdist_auto_num_workers

ROOT = Path(__file__).resolve().parents[2]


def suite(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run the suite as a person at a bench does."""
    command = [sys.executable, "-m", "pytest", *arguments, "--bench", "nowhere.toml"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    return subprocess.run(command, cwd=ROOT, env=alone, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_several_workers_with_hardware_are_rejected() -> None:
    done = suite("tests/contract", "-n", "2")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "two workers must not drive one arm" in done.stderr


@pytest.mark.slow
def test_hardware_tests_run_without_workers() -> None:
    done = suite("tests/contract", "-k", "motions_outside and fake")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
    assert "bringing up nodes" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "bench", "workers"),
    [(["tests"], None, 4), (["tests"], "my_bench.toml", 0), (["tests/unit/test_support.py"], None, 0)],
)
def test_workers_are_used_for_simulated_devices_only(
    arguments: list[str], bench: str | None, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    config: Any = SimpleNamespace(args=arguments, getoption={"--bench": bench}.get)
    assert pytest_xdist_auto_num_workers(config) == workers
