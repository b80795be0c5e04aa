"""The program to which something happens in `rig benchmark safety`, and what happens to it."""

import os
import resource
import signal
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drivers.children import python_command
from drivers.errors import DeviceError
from rig.benchmark.wire.safety_events import Event

STATE = "XDG_STATE_HOME"
TWICE_S = 0.15
"""Between two signals: the first has begun to work."""
DASHBOARD_PORT = 29999
POWER_S = 6.0
KEPT_LINES = 200
READ_S = 2.0
"""How long a pipe may stay open whose program has ended: its children go too."""


class TrialProgram:
    """A trial of two lifts that goes on with the second one, at a bench that counts as real."""

    def __init__(self, bench: Path, session: Path, object_id: str) -> None:
        command = python_command("-m", "rig", "trial", "--lifts", 2, "--object", object_id)
        command += ["--bench", str(bench), "--out", str(session), "--resume", "--yes", "--no-report"]
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._process = subprocess.Popen(  # noqa: S603 - our own program, no shell
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,  # no file: a disk that is full keeps nobody from being told
            text=True,
            errors="replace",
            start_new_session=True,  # a Ctrl-C at the benchmark's terminal is the benchmark's
            preexec_fn=_hear_all,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Of the program."""
        return self._process.pid

    @property
    def code(self) -> int:
        """Its exit code, negative for a signal; it has ended."""
        return self._process.wait()

    def over(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def check(self) -> None:
        """Raise `DeviceError` where it has ended."""
        if self.over():
            raise DeviceError(f"safety: the trial ended too early: {self.said()}")

    def send(self, number: signal.Signals) -> None:
        """Send a signal; to one that has ended, none."""
        self._process.send_signal(number)

    def wait(self, limit_s: float) -> None:
        """Wait for its end; where it does not come, end it, and have it said."""
        try:
            self._process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._reader.join(READ_S)
            self._lines.append(f"did not end within {limit_s:.0f} s")

    def said(self) -> str:
        """Its last line on stderr, once it has ended; from where a traceback begins, if there is one."""
        self._reader.join(READ_S)
        lines = list(self._lines)
        first = next((i for i, line in enumerate(lines) if "Traceback" in line), -1)
        return "\n".join(lines[first:])

    def _read(self) -> None:
        self._lines.extend(line.rstrip() for line in self._process.stderr or () if line.strip())

    def close(self) -> None:
        """End it, if it has not."""
        self._process.kill()
        self._process.wait()
        self._reader.join(READ_S)
        if self._process.stderr is not None:
            self._process.stderr.close()


def strike(event: Event, program: TrialProgram, call: Callable[..., Mapping[str, Any]]) -> int:
    """Let it happen; return when, the last of several, monotonic ns. call: the fakes' side channel's."""
    for number in event.signals[:-1]:
        program.send(number)
        time.sleep(TWICE_S)
    event_ns = time.monotonic_ns()
    for number in event.signals[-1:]:
        program.send(number)
    if event.fault is not None:
        device, kind = event.fault
        call("fault", device=device, kind=kind)
    if event.disk_full:
        fill_disk(program.pid)
    return event_ns


def fill_disk(pid: int) -> None:
    """Have every further byte that a process writes to a file refused, as on a full disk."""
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))


@contextmanager
def own_state(folder: Path) -> Iterator[None]:
    """Have hands remembered in this folder, by this process and its programs: it is another bench's hand."""
    before = os.environ.get(STATE)
    os.environ[STATE] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(STATE, None)
        if before is not None:
            os.environ[STATE] = before


def switch_on(host: str) -> None:
    """Switch an arm on and release its brakes at the pendant, where an emergency stop took its power."""
    if _dashboard(host, "robotmode").endswith("RUNNING"):
        return
    _dashboard(host, "brake release")
    deadline = time.monotonic() + POWER_S
    while not _dashboard(host, "robotmode").endswith("RUNNING"):
        if time.monotonic() > deadline:
            raise DeviceError("safety: the simulated arm cannot be switched on again")
        time.sleep(0.1)


def _dashboard(host: str, request: str) -> str:
    with socket.create_connection((host, DASHBOARD_PORT), timeout=2.0) as connection:
        lines = connection.makefile("rb")
        lines.readline()  # its greeting
        connection.sendall(f"{request}\n".encode())
        return lines.readline().decode().strip()


def _hear_all() -> None:
    """Hear every signal, also where this benchmark was started to outlive its terminal."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)
