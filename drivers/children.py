"""Python processes that this program starts: none of them imports from the current folder.

Python puts the current folder first on `sys.path` for `-c` and `-m`, which is how `multiprocessing` and we
ourselves start a process. A file `threading.py` there, as in a session of somebody else, would be run. Every
process of ours is therefore started with the command or the context given here.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable that keeps the current folder off `sys.path`, as the option -P does."""
FROM_TERMINAL = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
"""Signals that a terminal sends to all processes started from it."""
_environment = threading.RLock()


def python_command(*arguments: object) -> list[str]:
    """Return the command line of this Python that imports nothing from the current folder."""
    return [sys.executable, "-P", *map(str, arguments)]


class _SafeProcess(SpawnProcess):
    def start(self) -> None:
        with _safe_path():
            super().start()


class _SafeContext(SpawnContext):
    Process = _SafeProcess


def spawn_context() -> SpawnContext:
    """Return the `multiprocessing` context in which this program starts processes.

    Processes, and the resource tracker that `multiprocessing` starts beside them, inherit `PYTHONSAFEPATH`:
    `multiprocessing` writes their command lines itself and takes no further option.
    """
    with _safe_path():
        resource_tracker.ensure_running()
    return _SafeContext()


def leave_signals_to_parent() -> None:
    """Ignore signals of the terminal in a child: the parent makes the bench safe and then ends the child."""
    for number in FROM_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def end_with_parent() -> None:
    """Exit as soon as the parent is gone, even if it was killed. Call it in a `multiprocessing` child."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent.sentinel,), daemon=True).start()


def _watch(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Set the variable for the children that are started meanwhile, and for no program of other people."""
    with _environment:
        before = os.environ.get(SAFE_PATH)
        os.environ[SAFE_PATH] = "1"
        try:
            yield
        finally:
            if before is None:
                del os.environ[SAFE_PATH]
            else:
                os.environ[SAFE_PATH] = before
