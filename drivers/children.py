"""Start Python child processes that import nothing from the current folder.

Python puts the current folder first on `sys.path` for `-c` and `-m`; `multiprocessing` and this program start
processes that way. A file such as `threading.py` there, for example in another user's session folder, would
be executed. All child processes are therefore started with the command or the context of this module.
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
"""Environment variable that excludes the current folder from `sys.path`, as the option -P does."""
FROM_TERMINAL = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
"""Signals that a terminal sends to all processes that were started from it."""
_environment = threading.RLock()


def python_command(*arguments: object) -> list[str]:
    """Return a command line for this Python interpreter that imports nothing from the current folder."""
    return [sys.executable, "-P", *map(str, arguments)]


class _SafeProcess(SpawnProcess):
    def start(self) -> None:
        with _safe_path(), signals_of_terminal_held():
            super().start()


class _SafeContext(SpawnContext):
    Process = _SafeProcess


def spawn_context() -> SpawnContext:
    """Return the `multiprocessing` context in which this program starts processes.

    The processes, and the resource tracker of `multiprocessing`, inherit `PYTHONSAFEPATH`. An option on the
    command line is not possible, because `multiprocessing` composes the command lines itself.
    """
    with _safe_path():
        resource_tracker.ensure_running()
    return _SafeContext()


@contextmanager
def signals_of_terminal_held() -> Iterator[None]:
    """Start a child in this block that calls `leave_signals_to_parent`.

    Until it does, the signals of the terminal wait in the child, which would otherwise end with a traceback
    while it starts. Signals to this process wait until the end of the block.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_signals_to_parent() -> None:
    """Ignore terminal signals in a child: the parent first makes the bench safe, then ends the child."""
    for number in FROM_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, FROM_TERMINAL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def end_with_parent(sentinel: int | None = None) -> None:
    """Exit as soon as the parent is gone, even if it was killed.

    sentinel: a pipe whose other end only the parent has; in a `multiprocessing` child there is one.
    """
    parent = multiprocessing.parent_process()
    sentinel = parent.sentinel if sentinel is None and parent is not None else sentinel
    if sentinel is not None:
        threading.Thread(target=_watch, args=(sentinel,), daemon=True).start()


def _watch(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Set the variable while children are started; other programs started later do not inherit it."""
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
