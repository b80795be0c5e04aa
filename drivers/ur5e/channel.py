"""A supervised child process of the arm's driver, and calls to it: one JSON line each, with a deadline."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from drivers.children import python_command
from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError

_ROOT = Path(__file__).resolve().parents[2]
_TAIL_BYTES = 400
"""Bytes at the end of a process's output that are searched for its last line."""
_END_S = 1.0
"""Longest wait for the end of a child process that was killed."""
_SEND_S = 1.0
"""Time limit for sending a call."""
_CHECK_S = 0.1
"""Interval at which a waiting call checks whether the process still runs."""
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")
Check = Callable[[], object]


class ChildProcess:
    """A Python module run as a child process; its output is kept for the error message if it dies."""

    def __init__(self, name: str, module: str, arguments: tuple[object, ...], fds: tuple[int, ...]) -> None:
        self.name = name
        self._output = tempfile.TemporaryFile()
        paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(  # noqa: S603 - our own module, no shell
            python_command("-m", module, *arguments),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            pass_fds=fds,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # the parent handles a Ctrl-C: it stops the arm first
        )

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def death(self) -> str:
        """Return how the process ended, with its last line of output."""
        code = self._process.poll()
        if code is None:
            return f"{self.name} runs"
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        return f"{self.name} ended {how}{self._last_words()}"

    def wait(self, timeout_s: float) -> None:
        """Wait until the process ends, at most `timeout_s`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def kill(self) -> None:
        """End the process now; `death` still returns how it ended."""
        self._process.kill()

    def end(self) -> None:
        """End the process now and delete its output. Safe to call twice."""
        self._process.kill()
        self.wait(_END_S)
        self._output.close()

    def _last_words(self) -> str:
        if self._output.closed:
            return ""
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - _TAIL_BYTES))
        words = self._output.read().decode(errors="replace").split("\n")
        lines = [line.strip() for line in words if line.strip()]
        return f" ({lines[-1]})" if lines else ""


def no_check() -> None:
    """Permit a call unconditionally."""


class Channel:
    """Connection to a process; any thread may call, one call at a time.

    `multiprocessing.connection` is not used, because its `recv` has no deadline after the first byte of an
    answer: if the process were stopped at that point, the caller would wait forever.
    """

    def __init__(self, connection: socket.socket, process: ChildProcess, clock: Clock) -> None:
        self._connection = connection
        self._process = process
        self._clock = clock
        self._lock = threading.Lock()
        self._rest = b""
        self._number = 0
        """Number of the newest call. The answer to an interrupted call has an older number and is skipped."""

    def wait_ready(self, timeout_s: float, check: Check) -> None:
        """Wait until the process reports that it is ready. Raises `DeviceError` with its reason.

        check: called repeatedly during the wait; raises if further waiting is pointless.
        """
        with self._lock:
            self._receive(timeout_s, "start", check)  # the ready report is not an answer: its number is 0

    def call(
        self,
        method: Callable[Concatenate[Any, Arguments], Answer],
        timeout_s: float,
        check: Check,
        /,
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Answer:
        """Call a method in the process, and return its answer as JSON decodes it.

        check: called just before sending; may raise. Raises `DeviceError` if the process has ended or
        answers with an error. If it does not answer, raises `DeviceTimeoutError` and ends the process, so
        that it cannot execute the call later.
        """
        name = method.__name__
        if not self._lock.acquire(timeout=host_s(self._clock, timeout_s)):
            raise DeviceTimeoutError(f"arm: {self._process.name} is busy; '{name}' was not sent")
        try:
            check()
            self._number += 1
            request = {"number": self._number, "call": name, "arguments": arguments, "named": named}
            try:
                self._connection.settimeout(host_s(self._clock, _SEND_S))
                self._connection.sendall(json.dumps(request).encode() + b"\n")
            except OSError as error:
                raise self._lost(name) from error
            return self._receive(timeout_s, name)
        finally:
            self._lock.release()

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        self._connection.close()

    def _receive(self, timeout_s: float, name: str, check: Check = no_check) -> Any:
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while (answer := self._next_answer())["number"] != self._number:
            if self._clock.now_ns() >= deadline:
                self._process.kill()
                raise DeviceTimeoutError(
                    f"arm: '{name}' was not answered within {timeout_s:g} s; {self._process.name} was ended. "
                    "Check the controller's network and pendant, then connect again"
                )
            check()
            self._take(min(_CHECK_S, (deadline - self._clock.now_ns()) / NS_PER_S), name)
        if "error" in answer:
            raise DeviceError(f"arm: '{name}' failed: {answer['error']}")
        return answer["value"]

    def _next_answer(self) -> dict[str, Any]:
        """Return the next complete answer; one with number None if there is none."""
        if b"\n" not in self._rest:
            return {"number": None}
        line, self._rest = self._rest.split(b"\n", 1)
        return json.loads(line)

    def _take(self, timeout_s: float, name: str) -> None:
        try:
            self._connection.settimeout(max(timeout_s, 1e-3))
            data = self._connection.recv(65536)
        except TimeoutError:
            return
        except OSError as error:
            raise self._lost(name) from error
        if not data:
            raise self._lost(name)
        self._rest += data

    def _lost(self, name: str) -> DeviceError:
        self._process.wait(host_s(self._clock, _CHECK_S))
        return DeviceError(
            f"arm: connection lost at '{name}': {self._process.death()}; the arm's state is unknown. "
            "Inspect it, then connect again"
        )
