"""The user's own command, run on faults, questions and the end without blocking the bench."""

import os
import queue
import shlex
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Self

from drivers.errors import InputError
from rig.live.onlookers import Event

EVENTS = ("fault", "question", "end")
LONGEST_S = 10.0
"""Timeout of the command; at its end the rig waits at most this long for the last one."""
MOST_WAITING = 32
MOST_CHARACTERS = 4000


class Notifier:
    """Runs COMMAND EVENT TEXT for each event, one after another, on a separate thread.

    command: split into words like in a shell, but no shell runs it. warn: takes one warning if the command
    fails. Raises `InputError` for a command that cannot be run.
    """

    def __init__(self, command: str, warn: Callable[[str], None], longest_s: float = LONGEST_S) -> None:
        self._words = _words(command)
        self._warn, self._longest_s = warn, longest_s
        self._waiting: queue.Queue[Event | None] = queue.Queue(MOST_WAITING)
        self._warned = False
        self._late = threading.Event()
        self._running: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._work, daemon=True, name="notify")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for running commands, at most `longest_s`."""
        with suppress(queue.Full):
            self._waiting.put_nowait(None)
        self._thread.join(self._longest_s)
        self._late.set()
        if self._thread.is_alive() and self._running is not None:
            _kill(self._running)

    def tell(self, event: Event) -> None:
        """Queue the command for an event of one of `EVENTS`."""
        if event.kind in EVENTS:
            try:
                self._waiting.put_nowait(event)
            except queue.Full:
                self._failed("it is slower than the events")

    def _work(self) -> None:
        while not self._late.is_set() and (event := self._waiting.get()) is not None:
            self._run(event)

    def _run(self, event: Event) -> None:
        text = event.text.replace("\0", " ")[:MOST_CHARACTERS]
        try:
            self._running = process = subprocess.Popen(  # noqa: S603 - the user's own command
                [*self._words, event.kind, text], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            self._failed(error.strerror or str(error))
            return
        try:
            if code := process.wait(self._longest_s):
                self._failed(f"it ended with {code}")
        except subprocess.TimeoutExpired:
            _kill(process)
            process.wait()
            self._failed(f"it took longer than {self._longest_s:g} s")

    def _failed(self, why: str) -> None:
        if not self._warned:
            self._warned = True
            self._warn(f"WARNING: --notify {shlex.join(self._words)}: {why}; the command itself continues")


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill a command with all its child processes."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _words(command: str) -> list[str]:
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(f"--notify {command}: cannot be split ({error}); check its quotes") from error
    if not words or shutil.which(words[0]) is None:
        raise InputError(f"--notify {command}: there is no such program; give its path, or install it")
    return words
