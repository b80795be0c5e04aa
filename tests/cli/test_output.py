"""Output that cannot be written: no traceback, and the work of the command is kept."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from support.command_line import rig
from support.marks import heavy

Run = Callable[..., "subprocess.CompletedProcess[str]"]
STORED = Path(__file__).parents[1] / "data"


QUICK = """
import pytest
from support.quick_lifts import quick_lifts
from rig.cli.main import main
quick_lifts(pytest.MonkeyPatch())
main()
"""
"""Program whose lifts take no time."""


def process(
    arguments: Sequence[object], program: Sequence[str] = ("-m", "rig"), **streams: Any
) -> "subprocess.CompletedProcess[str]":
    """Run `rig ARGUMENTS` in a separate process with the system's streams."""
    command = [sys.executable, *program, *map(str, arguments)]
    return subprocess.run(command, text=True, timeout=120, check=False, **streams)


@pytest.mark.heavy
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("arguments", [("sessions", STORED, "--json"), ("--help",)])
def test_unwritable_results_are_a_one_line_error(arguments: Sequence[object]) -> None:
    with open("/dev/full", "w") as full:
        done = process(arguments, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("rig: the output cannot be written (No space left on device)")
    assert "Traceback" not in done.stderr


def test_slow_command_prints_loading_on_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.terminal.screen.SILENT_S", 0.1)
    monkeypatch.setattr("rig.results.listing.find_sessions", lambda _: time.sleep(1.0) or [])
    done = rig("sessions", "--json")
    assert (done.returncode, done.stderr.splitlines()[0]) == (0, "loading ...")
    assert json.loads(done.stdout)["sessions"] == []


@pytest.mark.heavy
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_unwritable_progress_changes_nothing() -> None:
    with open("/dev/full", "w") as full:
        done = process(("sessions", STORED, "--json"), stdout=subprocess.PIPE, stderr=full)
    assert done.returncode == 0
    assert "stored_trial" in done.stdout


@pytest.mark.heavy
@pytest.mark.parametrize("arguments", [("sessions", STORED), ("--help",)])
def test_closed_output_pipe_changes_no_exit_code(arguments: Sequence[object]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = process(arguments, stdout=writing, stderr=subprocess.PIPE)
    finally:
        os.close(writing)
    said = [line for line in done.stderr.splitlines() if not line.startswith("loading")]
    assert (done.returncode, said) == (0, [])


@pytest.mark.heavy
def test_trial_with_a_closed_output_pipe_is_finished_and_kept(light_bench_file: Path, tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    what = ("trial", "--bench", light_bench_file, "--object", "t2", "--lifts", "1", "--estimator", "pca")
    try:
        done = process(
            (*what, "--no-report", "--out", tmp_path / "s", "--jobs", "1"),
            ("-c", QUICK), stdout=writing, stderr=writing, cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(STORED.parent)},
        )  # fmt: skip
    finally:
        os.close(writing)
    assert done.returncode == 0
    assert len((tmp_path / "s" / "lifts.jsonl").read_text().splitlines()) == 1


@pytest.mark.heavy
def test_unwritable_report_path_is_a_one_line_error(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.html"
    os.mkfifo(pipe)
    code_of_proc = 1 if os.access("/proc", os.W_OK) else 2  # for root only writing the file fails
    for place, said, code in (
        (pipe, "is not a file", 2),
        (Path("/proc/page.html"), "cannot be written", code_of_proc),
    ):
        done = rig("report", STORED / "stored_trial", "--out", place)
        assert done.returncode == code
        assert f"rig: {place}: {said}" in done.stderr.splitlines()[-1]
    assert pipe.is_fifo()


def test_unexpected_os_error_is_a_one_line_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_dir", denied)
    done = rig("sessions", tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == f"rig: {tmp_path}: Permission denied"


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("suffix", "limit"),
    [
        ("webm", 1000),
        *heavy(*(("webm", limit) for limit in (0, 20_000, 100_000))),
        *heavy(*(("avi", limit) for limit in (0, 1000, 20_000, 100_000))),
    ],
)
def test_film_on_a_full_disk_is_an_error_and_keeps_the_older_film(
    tmp_path: Path, suffix: str, limit: int
) -> None:
    film = tmp_path / f"lift.{suffix}"
    film.write_bytes(b"the one before")
    code = (
        "import resource, sys; from rig.cli.main import main; "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); main()"
    )
    # -B: what Python compiles would be cut off by the limit as well, and found so by the next program
    trial = shutil.copytree(STORED / "stored_trial", tmp_path / "trial")
    arguments = ["play", str(trial), "--lift", "1", "--fps", "5", "--speed", "4", "--out", str(film)]
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, *arguments],
        capture_output=True, text=True, errors="replace", timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"rig: {film}: ")
    assert "free space" in last
    assert film.read_bytes() == b"the one before"
    assert sorted(path.name for path in tmp_path.iterdir()) == [film.name, "trial"]
