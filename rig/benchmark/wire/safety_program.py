"""The program of `rig benchmark safety`, its bench, and the events that happen to it."""

import os
import resource
import signal
import socket
import subprocess
import time
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


def as_real(bench: BenchConfig) -> BenchConfig:
    """Return a bench without [fakes], which counts as real and so must have the height of its table."""
    table = bench.table.model_copy(update={"top_m": TABLE_M})
    return bench.model_copy(update={"fakes": None, "table": table})


def start_trial(bench: Path, session: Path, object_id: str) -> subprocess.Popen[str]:
    """Start a trial of two lifts that continues with the second one.

    bench: file of a bench that counts as real.
    """
    command = python_command("-m", "rig", "trial", "--lifts", 2, "--object", object_id)
    command += ["--bench", str(bench), "--out", str(session), "--resume", "--yes", "--no-report"]
    return subprocess.Popen(  # noqa: S603 - our own program, no shell
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,  # no file: messages must arrive although the disk is full
        text=True,
        errors="replace",
        start_new_session=True,  # a Ctrl-C at the benchmark's terminal is the benchmark's
        preexec_fn=_reset_signals,
    )


def wait_for_end(program: subprocess.Popen[str], limit_s: float) -> str:
    """Wait for the end of a program and its children; after the time limit kill them.

    Return its last line on stderr, or everything from a traceback on; after the time limit, a line that says
    so. Its few lines fit into the pipe.
    """
    try:
        lines = program.communicate(timeout=limit_s)[1].splitlines()
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        lines = [*program.communicate()[1].splitlines(), f"did not end within {limit_s:.0f} s"]
    lines = [line.rstrip() for line in lines if line.strip()]
    first = next((i for i, line in enumerate(lines) if "Traceback" in line), -1)
    return "\n".join(lines[first:])


def _reset_signals() -> None:
    """Let the program receive every signal, also if this benchmark was started to outlive its terminal."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)


def strike(event: Event, program: subprocess.Popen[str], call: Callable[..., Mapping[str, Any]]) -> int:
    """Let an event happen to a program; return the time of its last part, monotonic ns.

    call: the fakes' side channel's. On a full disk the process cannot write another byte to any file.
    """
    for number in event.signals[:-1]:
        program.send_signal(number)
        time.sleep(TWICE_S)
    event_ns = time.monotonic_ns()
    for number in event.signals[-1:]:
        program.send_signal(number)
    if event.fault is not None:
        device, kind = event.fault
        call("fault", device=device, kind=kind)
    if event.disk_full:
        _, hard = resource.prlimit(program.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (0, hard))
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
