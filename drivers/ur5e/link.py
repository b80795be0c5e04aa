"""Start, supervise and end the two processes of the arm's driver: one receives states, one sends commands."""

import importlib.util
import os
import socket
from collections.abc import Callable
from typing import Concatenate

from drivers.clock import NS_PER_S, SystemClock, host_s, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError
from drivers.types import Vector6
from drivers.ur5e.channel import Answer, Arguments, Channel, Check, ChildProcess, no_check
from drivers.ur5e.control_commands import ControlCommands, Operation
from drivers.ur5e.probe import Version
from drivers.ur5e.shared_state import SharedState, StateSample
from drivers.values import require_fraction, require_number, require_numbers

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
CALL_S = 1.0
"""Time limit of a call of the command process."""
STOP_CALL_S = 0.3
STOPS = (ControlCommands.stop_linear, ControlCommands.end_program)
"""Calls with the shorter time limit STOP_CALL_S: if it passes, the arm is stopped over the dashboard."""


class ControlClient:
    """Client of the command process, which executes the methods of `ControlCommands`.

    Each call raises `DeviceError` if the process has ended or ur-rtde fails in it. If the process does not
    answer, the call raises `DeviceTimeoutError` and the process is ended.
    """

    def __init__(self, host: str, state_fd: int, clock: SystemClock) -> None:
        """Start the process. state_fd: file descriptor of the `SharedState` that it reads."""
        here, there = socket.socketpair()
        with there:
            self._process = ChildProcess(
                "the command process",
                "drivers.ur5e.control_process",
                (host, there.fileno(), state_fd, os.getpid(), clock.slowness),
                (state_fd, there.fileno()),
            )
        self._channel = Channel(here, self._process, clock)

    @property
    def alive(self) -> bool:
        return self._process.alive

    def wait_ready(self, timeout_s: float, check: Check) -> None:
        """Wait until the control program runs on the controller. Raises `DeviceError` with the reason.

        check: called repeatedly during the wait; raises if further waiting is pointless.
        """
        self._channel.wait_ready(timeout_s, check)

    def end(self) -> None:
        """End the process now. Safe to call twice."""
        self._process.end()
        self._channel.close()

    def ask(
        self,
        command: Callable[Concatenate[ControlCommands, Arguments], Answer],
        /,
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Answer:
        """Call a method of `ControlCommands` in the process, and return its result."""
        limit_s = STOP_CALL_S if command in STOPS else CALL_S
        return self._channel.call(command, limit_s, no_check, *arguments, **named)

    def operation(self) -> Operation:
        return Operation(*self.ask(ControlCommands.operation))

    def move_linear(
        self, pose: Vector6, speed_m_s: float, acceleration_m_s2: float, check: Check
    ) -> tuple[bool, int]:
        """Start a straight motion, see `ControlCommands`. check: called just before sending; may raise."""
        command = ControlCommands.move_linear
        return self._channel.call(command, CALL_S, check, pose, speed_m_s, acceleration_m_s2)


class ArmLink:
    """State and commands of one arm, through ur-rtde in separate processes."""

    def __init__(self, host: str, rate_hz: float, version: Version, clock: SystemClock) -> None:
        """Start to receive states. Raises `DeviceError` if no state arrives."""
        require_ur_rtde()
        self._host, self._clock = host, clock
        self._state = SharedState()
        self._control: ControlClient | None = None
        with_payload = int(version >= WITH_PAYLOAD)
        arguments = (host, rate_hz, self._state.fd, os.getpid(), with_payload, clock.slowness)
        self._listener = ChildProcess(
            "the state process", "drivers.ur5e.state_process", arguments, (self._state.fd,)
        )
        try:
            if not wait_until(self._clock, self._has_state, STREAM_START_S, _POLL_S):
                raise DeviceTimeoutError(
                    f"arm: {self._host} accepts connections but sends no state; restart the controller"
                )
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """End both processes. Safe to call twice."""
        self.end_control()
        self._listener.end()
        self._state.close()

    def sample(self) -> StateSample:
        """Return the newest sample; each call counts as a sign of life (`drivers.ur5e.heartbeat`).

        Raises `DeviceTimeoutError` if the sample is stale, `DeviceError` if the state process has ended,
        `InvalidStateError` if the controller sent NaN or infinity.
        """
        now_ns = self._clock.now_ns()  # before the sample is read: the host may suspend this program between
        self._state.note_poll(now_ns)
        sample = self._state.read()
        age_s = (now_ns - sample.received_ns) / NS_PER_S if sample else float("inf")
        if sample is not None and age_s < STALE_S:
            # Raise `InvalidStateError` for NaN or infinity. Payload and its centre may be NaN: not
            # reported.
            for name in ("joints_rad", "pose", "speed", "wrench"):
                require_numbers(f"the arm's {name}", getattr(sample, name), 6)
            require_number("the arm's timestamp_s", sample.timestamp_s)
            require_fraction("the arm's speed_fraction", sample.speed_fraction)
            return sample
        if sample is not None and not sample.received_ns:
            self._listener.wait(host_s(self._clock, END_S))
        if not self._listener.alive:
            raise DeviceError(
                f"arm: connection lost: {self._listener.death()}; its state is unknown. "
                "Inspect it, check the network, then connect again"
            )
        raise DeviceTimeoutError(
            f"arm: no new state for {age_s:.2f} s (limit {STALE_S} s), so its state is unknown; "
            "inspect it, check the controller and the network, then connect again"
        )

    @property
    def guiding_lost(self) -> bool:
        """Whether guiding by hand was ended because this program did not poll the arm."""
        return self._state.guiding_lost()

    def start_control(self) -> None:
        """Start the command process, which uploads the control program. Nothing moves."""
        for left in reversed(range(START_TRIES)):
            self.end_control()
            self._control = ControlClient(self._host, self._state.fd, self._clock)
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
        return self._control is not None and self._control.alive

    @property
    def control(self) -> ControlClient:
        """The client of the command process. Raises `NotConnectedError` if it was ended."""
        control = self._control
        if control is None:
            raise NotConnectedError("arm: its command process was ended by a stop; recover or connect again")
        return control

    def _has_state(self) -> bool:
        if self._state.read() is not None:
            return True
        if not self._listener.alive:
            raise DeviceError(
                f"arm: no state from {self._host}: {self._listener.death()}; "
                "make sure that no fieldbus or other client holds its registers, then connect again"
            )
        return False


def require_ur_rtde() -> None:
    """Raise `DeviceError` if the arm's client library is not installed."""
    if any(importlib.util.find_spec(name) is None for name in ("rtde_control", "rtde_receive")):
        raise DeviceError(
            "arm: the library ur-rtde is not installed here (it exists for Linux on x86-64, Python 3.11 and "
            "3.12); install it, or use a bench with another arm"
        )
