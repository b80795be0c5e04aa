"""The calls of ur-rtde's control interface, and the process that executes them.

When the interface loses its connection it reconnects, and crashes with a segmentation fault (ur-rtde 1.6.5).
It therefore runs in a separate process, which exits as soon as the arm's state is too old, before the
interface notices the loss.

    python -m drivers.ur5e.control_process HOST SOCKET_FD STATE_FD PARENT_PID SLOWNESS

Each line on the socket is {"number": n, "call": name, "arguments": [...], "named": {...}}; each answer is
{"number": n, "value": ...} or {"number": n, "error": text}. Answer 0 reports that the process is ready.
Between calls the process kicks the controller's watchdog: if this process ends, the program on the
controller stops the arm within one period of `WATCHDOG_HZ`. If its parent ends, or does not poll the arm
during a motion (`drivers.ur5e.heartbeat`), this process stops the arm itself.
"""

import faulthandler
import json
import os
import select
import socket
import sys
import threading
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any, NamedTuple

from drivers.clock import Clock, SystemClock, host_s, require_full_speed, to_ns
from drivers.realtime import ask_for_realtime, ordinary
from drivers.ur5e.heartbeat import Heartbeat, Program
from drivers.ur5e.shared_state import SharedState

KICK_S = 0.02
"""Interval at which the controller's watchdog is kicked."""
WATCHDOG_HZ = 12.5
"""Lowest rate of kicks: after 80 ms without one the controller ends the program."""


class Operation(NamedTuple):
    """Number of the newest operation on the controller, and whether it is running.

    halted: reason if `drivers.ur5e.heartbeat` stopped it before its end.
    """

    number: int
    running: bool
    halted: str = ""


class Watchdog:
    """Kicks the controller's watchdog after it was started."""

    def __init__(self, control: Any, clock: Clock) -> None:
        self._control, self._clock = control, clock
        self._next_ns: int | None = None

    def start(self) -> bool:
        """Start the watchdog: from now on the program ends if nothing is written for 80 ms."""
        started = self._control.setWatchdog(WATCHDOG_HZ)
        self._next_ns = self._clock.now_ns() if started else None
        return started

    def kick(self) -> None:
        if self._next_ns is not None and self._clock.now_ns() >= self._next_ns:
            self._next_ns = self._clock.now_ns() + to_ns(KICK_S)
            if self._control.isProgramRunning():
                self._control.kickWatchdog()


class ControlCommands:
    """The calls. `control` is ur-rtde's `RTDEControlInterface`, which has no type hints.

    Poses are x y z in m and a rotation vector in rad. A result of False: the controller rejected the command.
    """

    def __init__(self, control: Any, watchdog: Watchdog, heartbeat: Heartbeat) -> None:
        self._control, self._watchdog, self._heartbeat = control, watchdog, heartbeat
        self._guided = False

    def tcp(self) -> Sequence[float]:
        return self._control.getTCPOffset()

    def set_tcp(self, flange_tcp: Sequence[float]) -> tuple[bool, Sequence[float]]:
        """Set the TCP (x y z in m, rotation vector in rad); also return the TCP that is set afterwards."""
        return self._control.setTcp(flange_tcp), self._control.getTCPOffset()

    def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> bool:
        return self._control.setPayload(mass_kg, cog_m)

    def start_watchdog(self) -> bool:
        """Make the controller end the program, and so the motion, if this process stops kicking it."""
        return self._watchdog.start()

    def joints_for(self, pose: Sequence[float], near_rad: Sequence[float]) -> list[float] | None:
        """Return joint angles that reach a pose, those closest to `near_rad`; None if there are none.

        The safety limits are checked first, because an inverse without a solution ends the program on the
        controller.
        """
        if not self._control.isPoseWithinSafetyLimits(pose):
            return None
        return self._control.getInverseKinematics(pose, near_rad)

    def move_linear(
        self, pose: Sequence[float], speed_m_s: float, acceleration_m_s2: float
    ) -> tuple[bool, int]:
        """Start a straight motion; also return the number of the operation before it."""
        before = self._control.getAsyncOperationProgressEx().operationId()
        self._heartbeat.begin(speed_m_s)
        return self._control.moveL(pose, speed_m_s, acceleration_m_s2, True), before

    def operation(self) -> Operation:
        status = self._control.getAsyncOperationProgressEx()
        return Operation(status.operationId(), status.isAsyncOperationRunning(), self._heartbeat.halted)

    def stop_linear(self, deceleration_m_s2: float) -> None:
        """Start braking along the path; if the arm is led by hand, guiding is ended first."""
        self._heartbeat.end()
        if self._guided:
            self.end_guiding()
        self._control.stopL(deceleration_m_s2, True)

    def begin_guiding(self) -> bool:
        """Let a person lead the arm by hand (URScript teach_mode)."""
        self._guided = True
        self._heartbeat.begin_guiding()
        return self._control.teachMode()

    def end_guiding(self) -> bool:
        """Return to position control (URScript end_teach_mode)."""
        self._heartbeat.end()
        self._guided = False
        return self._control.endTeachMode()

    def halted(self) -> str:
        """Return why `drivers.ur5e.heartbeat` ended the newest motion or guiding; empty if it did not."""
        return self._heartbeat.halted

    def zero_force_sensor(self) -> bool:
        return self._control.zeroFtSensor()

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for half a second."""
        return self._control.isSteady()

    def end_program(self) -> None:
        self._control.stopScript()


START_LIMIT_S = 10.0
"""Time limit for ur-rtde to connect and upload its program; then the process exits."""
STATE_LIMIT_S = 0.6
"""Age of the arm's state at which this process exits; ur-rtde reconnects after 2.5 s."""
WATCH_S = 0.05
"""Interval between checks of the state's age and of the parent process."""
TICK_S = 0.005
"""Longest wait for a call between two checks of the heartbeat."""
STOP_S = 1.0
"""Time for the arm to stop before the process exits because its parent ended."""
STOP_DECELERATION_M_S2 = 10.0
"""Deceleration of the stop after the client has closed the connection."""
STATE_LOST, PARENT_LOST = 3, 4
"""Exit codes of this process."""
AT_ONCE = ("stop_linear", "end_program", "operation", "halted")
"""Calls that stop the arm or need no answer of the controller; they keep the real-time priority."""
COMMANDS = {name: method for name, method in vars(ControlCommands).items() if not name.startswith("_")}


def serve(
    connection: socket.socket,
    commands: ControlCommands,
    watchdog: Watchdog,
    heartbeat: Heartbeat,
    clock: Clock,
) -> None:
    """Answer calls until the client closes the connection; then nobody supervises the arm, so stop it."""
    lines, tick_s = connection.makefile("rb"), host_s(clock, TICK_S)
    while True:
        watchdog.kick()
        heartbeat.check()
        if not select.select([connection], [], [], tick_s)[0]:
            continue
        line = lines.readline()
        if not line:
            answer(commands, {"call": "stop_linear", "arguments": [STOP_DECELERATION_M_S2], "named": {}})
            return
        asked_ns, request = clock.now_ns(), json.loads(line)
        # while ur-rtde waits for the controller it busy-waits, and would take the core from everything else
        with nullcontext() if request["call"] in AT_ONCE else ordinary():
            reply = answer(commands, request)
        connection.sendall(json.dumps(reply).encode() + b"\n")
        heartbeat.answered(asked_ns)


def answer(commands: ControlCommands, request: dict[str, Any]) -> dict[str, Any]:
    """Execute one call. An error of the library is also an answer."""
    number = request.get("number")
    try:
        return {
            "number": number,
            "value": COMMANDS[request["call"]](commands, *request["arguments"], **request["named"]),
        }
    except (RuntimeError, ValueError, TypeError, IndexError) as error:  # the exceptions that pybind11 raises
        return {"number": number, "error": str(error)}


def watch(state: SharedState, parent_pid: int, clock: Clock) -> None:
    """End this process if the arm's state is too old, or the parent has ended and the arm was stopped."""
    while True:
        clock.sleep_until(clock.now_ns() + to_ns(WATCH_S))
        sample = state.read()
        if sample is None or clock.now_ns() - sample.received_ns > to_ns(STATE_LIMIT_S):
            os._exit(STATE_LOST)
        if os.getppid() != parent_pid:
            clock.sleep_until(clock.now_ns() + to_ns(STOP_S))
            os._exit(PARENT_LOST)


def main(host: str, socket_fd: int, state_fd: int, parent_pid: int, slowness: int) -> None:
    """Connect, report that the process is ready, and serve calls. slowness: of the clock of all limits."""
    clock = SystemClock(slowness)
    require_full_speed(clock, "arm", host)
    faulthandler.dump_traceback_later(host_s(clock, START_LIMIT_S), exit=True)  # works while the GIL is held
    state = SharedState(state_fd)
    threading.Thread(target=watch, args=(state, parent_pid, clock), daemon=True).start()
    connection = socket.socket(fileno=socket_fd)
    try:
        from rtde_control import RTDEControlInterface

        ask_for_realtime()
        control = RTDEControlInterface(host)
    except (ImportError, RuntimeError, ValueError) as error:
        connection.sendall(json.dumps({"number": 0, "error": str(error)}).encode() + b"\n")
        return
    faulthandler.cancel_dump_traceback_later()
    connection.sendall(json.dumps({"number": 0, "value": "ready"}).encode() + b"\n")
    watchdog = Watchdog(control, clock)
    heartbeat = Heartbeat(control, state, Program(parent_pid, slowness), clock)
    serve(connection, ControlCommands(control, watchdog, heartbeat), watchdog, heartbeat, clock)
    sys.stdout.flush()
    os._exit(0)  # the interface's destructor takes half a second and has nothing left to do


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
