"""The cache of compiled loops, and the message about compiling."""

import fcntl
import importlib.util
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

import pytest
from numba.core import config
from numba.core.event import install_listener

from rig.tactile.slip.compiled import is_cached
from rig.tactile.slip.compiling import _other_half, _Report, compile_all

MODULE = "installed_loops"
TEXT = """
from rig.tactile.slip.compiled import compiled

@compiled
def doubled(value):
    return 2.0 * value
"""


@pytest.fixture(autouse=True)
def user_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield tmp_path / "cache"
    sys.modules.pop(MODULE, None)


def installed(folder: Path) -> Any:
    """Return the loop of an installation in that folder."""
    folder.mkdir(exist_ok=True)
    (folder / f"{MODULE}.py").write_text(TEXT)
    spec = importlib.util.spec_from_file_location(MODULE, folder / f"{MODULE}.py")
    sys.modules[MODULE] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.doubled


def test_second_installation_uses_the_loops_of_the_first(tmp_path: Path, user_cache: Path) -> None:
    for folder, compiled in (("first", 1), ("second", 0)):
        loop = installed(tmp_path / folder)
        assert loop(2.0) == 4.0
        assert (sum(loop.stats.cache_misses.values()), sum(loop.stats.cache_hits.values())) == (
            compiled, 1 - compiled,
        )  # fmt: skip
        assert Path(loop.stats.cache_path).parent == user_cache / "numba"


def test_changed_loops_are_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert installed(tmp_path / "first")(2.0) == 4.0
    monkeypatch.setitem(globals(), "TEXT", TEXT.replace("2.0", "3.0"))
    assert installed(tmp_path / "second")(2.0) == 6.0


def test_loop_is_cached_beside_its_file_or_nowhere_if_folders_are_not_writable(
    tmp_path: Path, user_cache: Path
) -> None:
    user_cache.touch()  # a file, so that no folder can be made
    loop = installed(tmp_path / "first")
    assert Path(loop.stats.cache_path) == tmp_path / "first" / "__pycache__"
    (tmp_path / "second").mkdir()
    (tmp_path / "second" / "__pycache__").touch()
    loop = installed(tmp_path / "second")
    assert not is_cached(loop)
    assert loop(2.0) == 4.0


def test_compiling_is_reported_once_and_only_if_something_is_compiled(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.progress._display", None)  # commands of other tests leave one
    monkeypatch.setattr("rig.tactile.slip.compiling._other_half", nullcontext)
    with caplog.at_level(logging.WARNING):
        for folder, messages in (("first", 1), ("second", 1)):
            with ExitStack() as begun, install_listener("numba:compile", _Report(begun)):
                installed(tmp_path / folder)(2.0)
                assert len(caplog.messages) == messages
    assert caplog.messages[0].startswith("compiling the estimator, about 12 s if two cores are idle, once")


def test_process_waits_while_another_one_compiles_and_starts_no_child(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("subprocess.Popen", None)
    entered = threading.Event()

    def enter() -> None:
        with _other_half(tmp_path):
            entered.set()

    with (tmp_path / "compiling.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waiting = threading.Thread(target=enter)
        waiting.start()
        assert not entered.wait(0.2)
    waiting.join(10.0)
    assert entered.is_set()


@pytest.mark.heavy
def test_child_process_compiles_the_other_half_into_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with _other_half(tmp_path):
        pass
    compiled = {file.name.split(".")[1].split("-")[0] for file in tmp_path.rglob("*.nbi")}
    assert {"fit_light", "weigh", "strongest_energy"} <= compiled
    assert "align" not in compiled


def test_cached_loops_of_the_estimator_cause_no_message(caplog: pytest.LogCaptureFixture) -> None:
    compile_all.cache_clear()
    compile_all()
    assert not caplog.messages
