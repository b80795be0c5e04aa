"""The cache of compiled loops, and the process that fills it."""

import fcntl
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import rig.__main__
from rig.experiments.process_pool import run_tasks
from rig.tactile.slip import compiling
from rig.tactile.slip.compiling import (
    ALL_COMPILED,
    LOCK,
    SOURCES,
    begin_compiling,
    cache_folder,
    is_compiling,
    wait_until_compiled,
)
from support.waiting import until

HERE = Path(compiling.__file__).parent
WAITING = [sys.executable, "-c", "import sys; sys.stdin.read()"]
"""Stands for the process that compiles; as that one, it ends when its standard input is closed."""
LOAD = "from rig.tactile.slip.all_loops import compile_all; compile_all()"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache; the process that compiles only waits."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(compiling, "python_command", lambda *_: WAITING)
    monkeypatch.setattr(compiling, "_child", None)
    monkeypatch.setattr(compiling, "_announced", False)
    cache_folder.cache_clear()
    yield tmp_path / "cache"
    cache_folder.cache_clear()
    if compiling._child is not None:
        compiling._child.kill()
        compiling._child.communicate()


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path | None:
    """Return the cache folder of an installation in a folder."""
    folder.mkdir(exist_ok=True)
    for name in SOURCES:
        if not (folder / name).exists():
            shutil.copy(HERE / name, folder)
    monkeypatch.setattr(compiling, "__file__", str(folder / "compiling.py"))
    cache_folder.cache_clear()
    return cache_folder()


def test_installations_share_the_loops_until_a_source_or_a_setting_of_numba_changes(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = installed(tmp_path / "first", monkeypatch)
    assert first is not None
    assert first.parent == cache / "numba"
    assert installed(tmp_path / "second", monkeypatch) == first
    (tmp_path / "second" / SOURCES[-1]).write_text("changed = True\n")
    assert installed(tmp_path / "second", monkeypatch) != first
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert installed(tmp_path / "first", monkeypatch) != first


def test_cache_is_beside_the_sources_or_nowhere_if_folders_are_not_writable(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.touch()  # a file, so that no folder can be made
    beside = installed(tmp_path / "first", monkeypatch)
    assert beside is not None
    assert beside.parent == tmp_path / "first" / "__pycache__"
    (tmp_path / "second").mkdir()
    (tmp_path / "second" / "__pycache__").touch()
    assert installed(tmp_path / "second", monkeypatch) is None


def test_without_a_cache_nothing_is_started_and_a_line_says_so_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "cache_folder", lambda: None)
    lines: list[str] = []
    for _ in range(2):
        begin_compiling(lines.append)
    assert len(lines) == 1
    assert "each time: set NUMBA_CACHE_DIR" in lines[0]
    assert not is_compiling()


def test_one_process_compiles_and_an_interrupted_one_is_replaced() -> None:
    folder, lines = cache_folder(), list[str]()
    assert folder is not None
    begin_compiling(lines.append)
    first = compiling._child
    begin_compiling(lines.append)
    assert compiling._child is first
    assert is_compiling()
    assert first is not None
    first.communicate()  # ends it before all is compiled
    assert not is_compiling()
    assert not wait_until_compiled(folder)
    begin_compiling(lines.append)
    assert compiling._child is not first
    assert len(lines) == 1


def test_nothing_is_started_if_all_loops_are_compiled() -> None:
    folder, lines = cache_folder(), list[str]()
    assert folder is not None
    (folder / ALL_COMPILED).touch()
    begin_compiling(lines.append)
    assert (lines, is_compiling(), wait_until_compiled(folder)) == ([], False, True)


def test_process_waits_while_another_one_compiles_and_starts_none() -> None:
    folder, results = cache_folder(), list[bool]()
    assert folder is not None
    with (folder / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        begin_compiling()
        assert compiling._child is None
        waiting = threading.Thread(target=lambda: results.append(wait_until_compiled(folder)))
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
        (folder / ALL_COMPILED).touch()
    waiting.join(10.0)
    assert results == [True]


@pytest.mark.parametrize(
    ("typed", "estimates"),
    [
        ("trial --lifts 5", True),
        ("live fake", True),
        ("estimate frames --estimator slip", True),
        ("estimate frames --estimator pca", False),
        ("estimate frames --estimator=pca", False),
        ("trial --dry-run", False),
        ("trial --help", False),
        ("report trial", False),
        ("--help", False),
        ("", False),
    ],
)
def test_commands_that_estimate_begin_to_compile_before_they_are_imported(
    typed: str, estimates: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(sys, "argv", ["rig", *typed.split()])
    monkeypatch.setattr(compiling, "begin_compiling", lambda _: done.append("compile"))
    monkeypatch.setattr("rig.cli.main.main", lambda: done.append("run"))
    rig.__main__.main()
    assert done == ["compile", "run"] if estimates else ["run"]


def seen_alone(folder: Path) -> bool:
    """Whether no other task has begun."""
    (folder / str(os.getpid())).touch()
    return len(list(folder.iterdir())) == 1


def test_one_worker_runs_alone_while_another_process_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_compiling(lambda _: None)
    tasks = [tmp_path / "begun"] * 3
    tasks[0].mkdir()
    results = run_tasks(seen_alone, tasks, jobs=2, fork=True)
    assert next(results)[1] is True
    assert len(tasks) == 2, "others wait"
    assert compiling._child is not None
    compiling._child.kill()
    assert len(list(results)) == 2


@pytest.mark.heavy
def test_second_command_compiles_nothing_and_an_interrupted_one_is_continued(
    tmp_path: Path, cache: Path
) -> None:
    folder = cache_folder()
    assert folder is not None
    command, quiet = [sys.executable, "-P", "-c", LOAD], subprocess.DEVNULL
    first = subprocess.Popen(command, stdout=quiet, stderr=quiet)
    until(lambda: any(folder.glob("*.nbi")), 120.0)
    first.kill()
    first.wait()
    until(lambda: not wait_until_compiled(folder), 60.0)  # the process that compiled has ended
    begun = {file.name: file.stat().st_mtime_ns for file in folder.glob("*.nbc")}
    subprocess.run(command, check=True)
    files = {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert begun.items() <= files.items()
    assert ALL_COMPILED in files
    (tmp_path / "elsewhere").mkdir()
    subprocess.run(command, check=True, cwd=tmp_path / "elsewhere")
    assert {file.name: file.stat().st_mtime_ns for file in folder.iterdir()} == files
