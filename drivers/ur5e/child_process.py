"""A supervised process of the arm's driver: started with a deadline, asked with a deadline, ended."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError

_ROOT = Path(__file__).resolve().parents[2]
_TAIL_BYTES = 400
_END_S = 1.0
_CHECK_S = 0.1


class ChildProcess:
    """A Python module run as a child, its output kept for the case that it dies."""

    def __init__(self, name: str, module: str, arguments: tuple[object, ...], fds: tuple[int, ...]) -> None:
        self._name = name
        self._output = tempfile.TemporaryFile()
        paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(  # noqa: S603 - our own module, no shell
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            pass_fds=fds,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # a Ctrl-C is the parent's to handle: it stops the arm first
        )

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def death(self) -> str:
        """How it ended, with the last it said."""
        code = self._process.poll()
        if code is None:
            return f"{self._name} runs"
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        return f"{self._name} ended {how}{self._last_words()}"

    def wait(self, timeout_s: float) -> None:
        """Give it time to end."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def end(self) -> None:
        """End it now. Safe to call twice."""
        self._process.kill()
        self.wait(_END_S)
        self._output.close()

    def _last_words(self) -> str:
        if self._output.closed:
            return ""
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - _TAIL_BYTES))
        words = self._output.read().decode(errors="replace").split("\n")
        said = [line.strip() for line in words if line.strip()]
        return f" ({said[-1]})" if said else ""


class CallableProcess(ChildProcess):
    """A child that answers one JSON line for each asked; calls come from any thread, one at a time."""

    def __init__(
        self, name: str, module: str, arguments: tuple[object, ...], fds: tuple[int, ...], clock: Clock
    ) -> None:
        self._here, there = socket.socketpair()
        with there:
            full = (arguments[0], there.fileno(), *arguments[1:])
            super().__init__(name, module, full, (*fds, there.fileno()))
        self._clock = clock
        self._lock = threading.Lock()
        self._rest = b""

    def wait_ready(self, timeout_s: float, check: Callable[[], object]) -> None:
        """Wait until the child says that it is ready. Raises `DeviceError` with its reason.

        check: is called meanwhile and raises when waiting has no point any more.
        """
        with self._lock:
            self._receive(timeout_s, "start", check)

    def call(
        self, name: str, *arguments: object, timeout_s: float, check: Callable[[], object] = lambda: None
    ) -> Any:
        """Ask, and return the answer. check: is called when it is this call's turn, and may raise.

        Raises `DeviceError` when the child died or answers with an error, `DeviceTimeoutError` when
        it does not answer; it is then ended, lest it does later what was asked now.
        """
        if not self._lock.acquire(timeout=timeout_s):
            raise DeviceTimeoutError(f"arm: {self._name} is busy; '{name}' was not asked")
        try:
            check()
            self._send(name, arguments)
            return self._receive(timeout_s, name)
        finally:
            self._lock.release()

    def end(self) -> None:
        """End it now. Safe to call twice."""
        super().end()
        self._here.close()

    def _send(self, name: str, arguments: tuple[object, ...]) -> None:
        try:
            self._here.settimeout(_END_S)
            self._here.sendall(json.dumps({"call": name, "args": arguments}).encode() + b"\n")
        except OSError as error:
            raise self._lost(name) from error

    def _receive(self, timeout_s: float, name: str, check: Callable[[], object] = lambda: None) -> Any:
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while b"\n" not in self._rest:
            if self._clock.now_ns() >= deadline:
                self._process.kill()
                raise DeviceTimeoutError(
                    f"arm: '{name}' was not answered within {timeout_s:g} s; {self._name} was ended. "
                    "Check the controller's network and pendant, then connect again"
                )
            check()
            self._take(min(_CHECK_S, (deadline - self._clock.now_ns()) / NS_PER_S), name)
        line, self._rest = self._rest.split(b"\n", 1)
        return self._opened(json.loads(line), name)

    def _take(self, timeout_s: float, name: str) -> None:
        try:
            self._here.settimeout(max(timeout_s, 1e-3))
            data = self._here.recv(65536)
        except TimeoutError:
            return
        except OSError as error:
            raise self._lost(name) from error
        if not data:
            raise self._lost(name)
        self._rest += data

    def _opened(self, answer: dict[str, Any], name: str) -> Any:
        if "error" in answer:
            raise DeviceError(f"arm: '{name}' failed: {answer['error']}")
        return answer["value"]

    def _lost(self, name: str) -> DeviceError:
        self.wait(_CHECK_S)
        return DeviceError(
            f"arm: connection lost at '{name}': {self.death()}; the arm's state is unknown. "
            "Look at it, then connect again"
        )
