"""The program of `rig benchmark safety`, its bench, and the events that happen to it."""

import resource
import signal
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.children import python_command
from drivers.errors import DeviceError
from rig.benchmark.wire.safety_events import Event
from rig.config import BenchConfig

TABLE_M = 0.02
TWICE_S = 0.15
"""Between two signals: the first has begun to work."""
DASHBOARD_PORT = 29999
POWER_S = 6.0
KEPT_LINES = 200
READ_S = 2.0
"""Longest time for which the pipe of an ended program stays open: its children end too."""


def as_real(bench: BenchConfig) -> BenchConfig:
    """Return a bench without [fakes], which counts as real and so must have the height of its table."""
    table = bench.table.model_copy(update={"top_m": TABLE_M})
    return bench.model_copy(update={"fakes": None, "table": table})


class TrialProgram:
    """A trial of two lifts that continues with the second one, at a bench that counts as real."""

    def __init__(self, bench: Path, session: Path, object_id: str) -> None:
        command = python_command("-m", "rig", "trial", "--lifts", 2, "--object", object_id)
        command += ["--bench", str(bench), "--out", str(session), "--resume", "--yes", "--no-report"]
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.process = subprocess.Popen(  # noqa: S603 - our own program, no shell
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,  # no file: messages must arrive although the disk is full
            text=True,
            errors="replace",
            start_new_session=True,  # a Ctrl-C at the benchmark's terminal is the benchmark's
            preexec_fn=_reset_signals,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def over(self) -> bool:
        """Whether it has ended."""
        return self.process.poll() is not None

    def wait(self, limit_s: float) -> None:
        """Wait for its end; after the time limit kill it, and add a line that says so."""
        try:
            self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self._reader.join(READ_S)
            self._lines.append(f"did not end within {limit_s:.0f} s")

    def said(self) -> str:
        """Return its last line on stderr after its end, or all from a traceback on."""
        self._reader.join(READ_S)
        lines = list(self._lines)
        first = next((i for i, line in enumerate(lines) if "Traceback" in line), -1)
        return "\n".join(lines[first:])

    def _read(self) -> None:
        self._lines.extend(line.rstrip() for line in self.process.stderr or () if line.strip())

    def close(self) -> None:
        """Kill it if it still runs."""
        self.process.kill()
        self.process.wait()
        self._reader.join(READ_S)
        if self.process.stderr is not None:
            self.process.stderr.close()


def _reset_signals() -> None:
    """Let the program receive every signal, also if this benchmark was started to outlive its terminal."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)


def strike(event: Event, program: TrialProgram, call: Callable[..., Mapping[str, Any]]) -> int:
    """Let an event happen; return the time of its last part, monotonic ns. call: the fakes' side channel's.

    On a full disk the process cannot write another byte to any file.
    """
    for number in event.signals[:-1]:
        program.process.send_signal(number)
        time.sleep(TWICE_S)
    event_ns = time.monotonic_ns()
    for number in event.signals[-1:]:
        program.process.send_signal(number)
    if event.fault is not None:
        device, kind = event.fault
        call("fault", device=device, kind=kind)
    if event.disk_full:
        _, hard = resource.prlimit(program.process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(program.process.pid, resource.RLIMIT_FSIZE, (0, hard))
    return event_ns


def switch_on(host: str) -> None:
    """Switch an arm on and release its brakes at the pendant, if an emergency stop took its power."""
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
