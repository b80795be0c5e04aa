"""The process that commands the arm, as its parent asks it: a method for each call, typed."""

import os
import socket
from collections.abc import Callable, Sequence
from typing import Concatenate

from drivers.clock import Clock
from drivers.types import Vector3, Vector6
from drivers.ur5e.channel import Answer, Arguments, Channel, Check, ChildProcess, no_check
from drivers.ur5e.control_commands import ControlCommands, MoveStart, Operation, TcpSetting

CALL_S = 1.0
STOP_CALL_S = 0.3
"""A stop has less time than other calls: what does not answer by then is stopped over the dashboard."""


class ControlClient:
    """What `drivers.ur5e.control_commands.ControlCommands` does, asked for from this process.

    Each call raises `DeviceError` when the process is gone or ur-rtde fails in it,
    `DeviceTimeoutError` when it does not answer; the process is then ended.
    """

    def __init__(self, host: str, state_fd: int, clock: Clock) -> None:
        """Start the process. state_fd: the `SharedState` it watches the arm by."""
        here, there = socket.socketpair()
        with there:
            self._process = ChildProcess(
                "the process that commands",
                "drivers.ur5e.control_process",
                (host, there.fileno(), state_fd, os.getpid()),
                (state_fd, there.fileno()),
            )
        self._channel = Channel(here, self._process, clock)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.alive

    def wait_ready(self, timeout_s: float, check: Check) -> None:
        """Wait until the control program runs on the controller. Raises `DeviceError` with the reason.

        check: is called meanwhile and raises when waiting has no point any more.
        """
        self._channel.wait_ready(timeout_s, check)

    def end(self) -> None:
        """End the process now. Safe to call twice."""
        self._process.end()
        self._channel.close()

    def tcp(self) -> Sequence[float]:
        """The TCP that the controller has: x y z in m, rotation vector in rad."""
        return self._ask(ControlCommands.tcp)

    def set_tcp(self, flange_tcp: Vector6) -> TcpSetting:
        """Set the TCP, and read it back."""
        return TcpSetting(*self._ask(ControlCommands.set_tcp, flange_tcp))

    def set_payload(self, mass_kg: float, cog_m: Vector3) -> bool:
        """Set mass and centre of gravity of what hangs on the flange; False when it was refused."""
        return self._ask(ControlCommands.set_payload, mass_kg, cog_m)

    def start_watchdog(self) -> bool:
        """Have the controller stop when the process falls silent; False when it was refused."""
        return self._ask(ControlCommands.start_watchdog)

    def joints_for(self, pose: Vector6, near_rad: Vector6) -> Sequence[float] | None:
        """Joint angles that reach a pose, those closest to `near_rad`; None when there are none."""
        return self._ask(ControlCommands.joints_for, pose, near_rad)

    def move_linear(
        self, pose: Vector6, speed_m_s: float, acceleration_m_s2: float, check: Check
    ) -> MoveStart:
        """Start a straight motion. check: is called just before it is sent, and may raise."""
        command = ControlCommands.move_linear
        return MoveStart(*self._channel.call(command, CALL_S, check, pose, speed_m_s, acceleration_m_s2))

    def operation(self) -> Operation:
        """How far the newest motion is."""
        return Operation(*self._ask(ControlCommands.operation))

    def stop_linear(self, deceleration_m_s2: float) -> None:
        """Begin to brake along the path."""
        self._channel.call(ControlCommands.stop_linear, STOP_CALL_S, no_check, deceleration_m_s2)

    def begin_guiding(self) -> bool:
        """Let the arm be led by hand; False when it was refused."""
        return self._ask(ControlCommands.begin_guiding)

    def end_guiding(self) -> bool:
        """Back to position control; False when it was refused."""
        return self._ask(ControlCommands.end_guiding)

    def halted(self) -> str:
        """Why the newest motion or guiding was ended because nobody looked; else ""."""
        return self._ask(ControlCommands.halted)

    def zero_force_sensor(self) -> bool:
        """Take the present force and torque as zero; False when it was refused."""
        return self._ask(ControlCommands.zero_force_sensor)

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for half a second."""
        return self._ask(ControlCommands.is_steady)

    def end_program(self) -> None:
        """End the program on the controller."""
        self._channel.call(ControlCommands.end_program, STOP_CALL_S, no_check)

    def _ask(
        self,
        command: Callable[Concatenate[ControlCommands, Arguments], Answer],
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Answer:
        return self._channel.call(command, CALL_S, no_check, *arguments, **named)
