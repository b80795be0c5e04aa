"""How the suite runs: one process at hardware, and what a busy computer excuses."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import CalibrationError, DeviceError
from support import side_by_side
from support.in_real_time import REASON, excuse_for
from support.side_by_side import give_way, pytest_xdist_auto_num_workers
from support.waking import others_s

ROOT = Path(__file__).resolve().parents[2]


def suite(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run the suite as somebody does who stands at a bench."""
    command = [sys.executable, "-m", "pytest", *arguments, "--bench", "nowhere.toml"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    return subprocess.run(command, cwd=ROOT, env=alone, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_two_workers_at_hardware_are_refused() -> None:
    done = suite("tests/contract", "-n", "2")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "two workers must not drive one arm" in done.stderr


@pytest.mark.slow
def test_at_hardware_there_are_no_workers() -> None:
    done = suite("tests/contract", "-k", "motions_outside and fake")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
    assert "bringing up nodes" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "bench", "workers"),
    [(["tests"], None, 3), (["tests"], "my_bench.toml", 0), (["tests/unit/test_support.py"], None, 0)],
)
def test_workers_are_for_folders_of_simulated_devices(
    arguments: list[str], bench: str | None, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    config: Any = SimpleNamespace(args=arguments, getoption={"--bench": bench}.get)
    assert pytest_xdist_auto_num_workers(config) == workers


@pytest.mark.parametrize(
    ("cores", "granted", "waits"), [(2, False, True), (2, True, False), (8, False, False), (8, True, False)]
)
def test_other_tests_wait_for_real_time_only_without_priority_and_spare_cores(
    cores: int, granted: bool, waits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over, waited, nices = tmp_path / "over", [], []
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(cores)), raising=False)
    monkeypatch.setattr(os, "setpriority", lambda which, who, nice: nices.append(nice))
    monkeypatch.setattr(side_by_side, "real_time_is_granted", lambda: granted)
    monkeypatch.setattr(side_by_side.time, "sleep", lambda s: waited.append(s) or over.touch())
    give_way(over)
    assert bool(waited) == waits
    assert nices == [side_by_side.OWN_NICE + (0 if waits else side_by_side.NICER)]


@pytest.mark.parametrize(("late_s", "others_cores"), [(0.2, 0.0), (0.0, 0.8)])
def test_a_busy_computer_excuses_lateness_and_nothing_else(late_s: float, others_cores: float) -> None:
    excuse = excuse_for(DeviceError("arm: not heard\nfor a while"), late_s, others_cores)
    assert excuse is not None
    assert excuse.startswith(REASON)
    assert excuse.endswith("(arm: not heard)")
    refused = AssertionError(f"the lift ended with {CalibrationError.__name__}")
    assert excuse_for(refused, late_s, others_cores) is None


def test_a_computer_with_time_excuses_nothing() -> None:
    assert excuse_for(DeviceError("arm: not heard"), late_s=0.01, others_cores=0.1) is None


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="there is no /proc here")
def test_cpu_time_of_other_processes_is_separated_from_the_tests() -> None:
    idle = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    burning = "import time\nwhile time.process_time() < 0.5: pass\nprint(flush=True)\ninput()"
    busy = subprocess.Popen([sys.executable, "-c", burning], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert busy.stdout is not None
        busy.stdout.readline()
        ours, of_others = others_s(os.getpid()), others_s(idle.pid)
        assert of_others - ours > 0.4
    finally:
        for process in (idle, busy):
            process.communicate(b"\n")
