"""Start, supervise and end the two processes of the arm's driver: one receives states, one sends commands.

Calls are one JSON line each, with a deadline.
"""

import contextlib
import importlib.util
import json
import os
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, TypeVarTuple

from drivers.children import python_command
from drivers.clock import NS_PER_S, Clock, SystemClock, host_s, to_ns, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError
from drivers.ur5e.controller import Dashboard, Version
from drivers.ur5e.processes import ControlCommands
from drivers.ur5e.shared_state import SharedState, StateSample
from drivers.values import require_fraction, require_number, require_numbers

_ROOT = Path(__file__).resolve().parents[2]
_TAIL_BYTES = 400
"""Bytes at the end of a process's output that are searched for its last line."""
_END_S = 1.0
"""Longest wait for the end of a child process that was killed."""
_SEND_S = 1.0
"""Time limit for sending a call."""
_CHECK_S = 0.1
"""Interval at which a waiting call checks whether the process still runs."""
Arguments = TypeVarTuple("Arguments")
Answer = TypeVar("Answer")
Check = Callable[[], object]


class ChildProcess:
    """A process of `drivers.ur5e.processes`; its output is kept for the error message if it dies."""

    def __init__(self, name: str, kind: str, arguments: tuple[object, ...], fds: tuple[int, ...]) -> None:
        self.name = name
        self._output = tempfile.TemporaryFile()
        paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(  # noqa: S603 - our own module, no shell
            python_command("-m", "drivers.ur5e.processes", kind, *arguments),
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
        lines = []
        if not self._output.closed:
            size = self._output.seek(0, os.SEEK_END)
            self._output.seek(max(0, size - _TAIL_BYTES))
            lines = [line.strip() for line in self._output.read().decode(errors="replace").split("\n")]
        last = next((f" ({line})" for line in reversed(lines) if line), "")
        return f"{self.name} ended {how}{last}"

    def wait(self, timeout_s: float) -> None:
        """Wait until the process ends, at most `timeout_s`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def kill(self) -> None:
        """End the process now; `death` still returns how it ended."""
        self._process.kill()

    def end(self) -> None:
        """End the process now and delete its output. Safe to call twice."""
        self.kill()
        self.wait(_END_S)
        self._output.close()


CALL_S, STOP_CALL_S = 1.0, 0.3
"""Time limits of a call of the command process, and of the calls in `STOPS`: if that passes, the arm is
stopped over the dashboard."""
STOPS = (ControlCommands.stop_linear, ControlCommands.end_program)


class ControlClient:
    """Client of the command process; any thread may call, one call at a time.

    `multiprocessing.connection` is not used, because its `recv` has no deadline after the first byte of an
    answer: if the process were stopped at that point, the caller would wait forever.
    """

    def __init__(self, connection: socket.socket, process: ChildProcess, clock: Clock) -> None:
        self._connection, self.process, self._clock = connection, process, clock
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

    def ask(
        self,
        command: Callable[[ControlCommands, *Arguments], Answer],
        *arguments: *Arguments,
        check: Check = lambda: None,
    ) -> Answer:
        """Call a method of `ControlCommands` in the process; return its answer as JSON decodes it.

        check: called just before sending; may raise. Raises `DeviceError` if the process has ended or answers
        with an error. If it does not answer, raises `DeviceTimeoutError` and ends the process, so that it
        cannot execute the call later.
        """
        name, timeout_s = command.__name__, STOP_CALL_S if command in STOPS else CALL_S
        if not self._lock.acquire(timeout=host_s(self._clock, timeout_s)):
            raise DeviceTimeoutError(f"arm: {self.process.name} is busy; '{name}' was not sent")
        try:
            check()
            self._number += 1
            request = {"number": self._number, "call": name, "arguments": arguments}
            try:
                self._connection.settimeout(host_s(self._clock, _SEND_S))
                self._connection.sendall(json.dumps(request).encode() + b"\n")
            except OSError as error:
                raise self._connection_error(name) from error
            return self._receive(timeout_s, name)
        finally:
            self._lock.release()

    def end(self) -> None:
        """End the process now. Safe to call twice."""
        self.process.end()
        self._connection.close()

    def _receive(self, timeout_s: float, name: str, check: Check = lambda: None) -> Any:
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while (answer := self._next_answer())["number"] != self._number:
            if self._clock.now_ns() >= deadline:
                self.process.kill()
                raise DeviceTimeoutError(
                    f"arm: '{name}' was not answered within {timeout_s:g} s; {self.process.name} was ended. "
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
            raise self._connection_error(name) from error
        if not data:
            raise self._connection_error(name)
        self._rest += data

    def _connection_error(self, name: str) -> DeviceError:
        self.process.wait(host_s(self._clock, _CHECK_S))
        return DeviceError(
            f"arm: connection lost at '{name}': {self.process.death()}; the arm's state is unknown. "
            "Inspect it, then connect again"
        )


STALE_S = 0.4
"""Age of the controller's newest time stamp from which the arm's state counts as unknown."""
STREAM_START_S = 3.0
"""Time limit for the first state after connecting."""
CONTROL_START_S = 8.0
"""Time limit for the control program to start on the controller."""
START_TRIES = 3
"""After a stop the first attempts of the control interface sometimes fail (users' reports)."""
END_S = 0.5
"""Time limit for the end of the state process."""
WITH_PAYLOAD: Version = (5, 6, 0, 0)
"""First controller software that reports the payload in its state."""
_POLL_S = 0.005
"""Interval at which the first state is polled."""


class ArmLink:
    """State and commands of one arm, through ur-rtde in separate processes."""

    def __init__(
        self, host: str, rate_hz: float, version: Version, dashboard: Dashboard, clock: SystemClock
    ) -> None:
        """Start to receive states. dashboard: is closed with the link.

        Raises `DeviceError` if ur-rtde is not installed, or if no state arrives.
        """
        if any(importlib.util.find_spec(name) is None for name in ("rtde_control", "rtde_receive")):
            raise DeviceError(
                'arm: ur-rtde is not installed: pip install "visuotactile-slip-rig[bench]" with Python 3.11 '
                "or 3.12 on Linux on x86-64, build it from source with pip install ur-rtde, or use a bench "
                "with another arm"
            )
        self.dashboard, self._host, self._clock = dashboard, host, clock
        self.state = SharedState()
        self._control: ControlClient | None = None
        self._common = (host, self.state.fd, os.getpid(), clock.slowness)
        arguments = (*self._common, rate_hz, int(version >= WITH_PAYLOAD))
        self._listener = ChildProcess("the state process", "state", arguments, (self.state.fd,))
        try:
            if not wait_until(self._clock, self._has_state, STREAM_START_S, _POLL_S):
                raise DeviceTimeoutError(
                    f"arm: {host} accepts connections but sends no state; restart the controller"
                )
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """End both processes, and close the dashboard. Safe to call twice."""
        self.end_control()
        self._listener.end()
        self.state.close()
        self.dashboard.close()

    def sample(self) -> StateSample:
        """Return the newest sample; each call counts as a sign of life (`drivers.ur5e.heartbeat`).

        Raises `DeviceTimeoutError` if the sample is stale, `DeviceError` if the state process has ended,
        `InvalidStateError` if the controller sent NaN or infinity.
        """
        now_ns = self._clock.now_ns()  # before the sample is read: the host may suspend this program between
        self.state.note_poll(now_ns)
        sample = self.state.read()
        age_s = (now_ns - sample.received_ns) / NS_PER_S if sample else float("inf")
        if sample is not None and age_s < STALE_S:
            # Payload and its centre are not checked: they are NaN if the controller does not report them.
            for name in ("joints_rad", "pose", "speed", "wrench"):
                require_numbers(f"the arm's {name}", getattr(sample, name), 6)
            require_number("the arm's timestamp_s", sample.timestamp_s)
            require_fraction("the arm's speed_fraction", sample.speed_fraction)
            return sample
        ended = sample is not None and not sample.received_ns
        if ended:
            self._listener.wait(host_s(self._clock, END_S))
        if not self._listener.alive:
            raise DeviceError(
                f"arm: connection lost: {self._listener.death()}; its state is unknown. "
                "Inspect it, check the network, then connect again"
            )
        what = "connection lost" if ended else f"no new state for {age_s:.2f} s (limit {STALE_S} s)"
        raise DeviceTimeoutError(
            f"arm: {what}, so its state is unknown; "
            "inspect it, check the controller and the network, then connect again"
        )

    def start_control(self) -> None:
        """Start the command process, which uploads the control program. Nothing moves."""
        for left in reversed(range(START_TRIES)):
            self.end_control()
            here, there = socket.socketpair()
            with there:
                arguments, fds = (*self._common, there.fileno()), (self.state.fd, there.fileno())
                process = ChildProcess("the command process", "control", arguments, fds)
            self._control = ControlClient(here, process, self._clock)
            try:
                return self._control.wait_ready(CONTROL_START_S, self.sample)
            except DeviceError:
                self.end_control()
                self.sample()
                if not left:
                    raise

    def end_control(self) -> None:
        """End the command process. Safe to call twice."""
        if self._control is not None:
            self._control.end()
            self._control = None

    @property
    def has_control(self) -> bool:
        return self._control is not None and self._control.process.alive

    @property
    def control(self) -> ControlClient:
        """The client of the command process. Raises `NotConnectedError` if it was ended."""
        control = self._control
        if control is None:
            raise NotConnectedError("arm: its command process was ended by a stop; recover or connect again")
        return control

    def _has_state(self) -> bool:
        if self.state.read() is not None:
            return True
        if not self._listener.alive:
            raise DeviceError(
                f"arm: no state from {self._host}: {self._listener.death()}; "
                "make sure that no fieldbus or other client holds its registers, then connect again"
            )
        return False
