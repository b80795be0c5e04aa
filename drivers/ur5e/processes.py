"""The two processes in which ur-rtde runs: one receives the arm's states, one executes commands.

    python -m drivers.ur5e.processes state HOST STATE_FD PARENT_PID SLOWNESS RATE_HZ WITH_PAYLOAD
    python -m drivers.ur5e.processes control HOST STATE_FD PARENT_PID SLOWNESS SOCKET_FD

State: if the controller sends nothing, the constructor of ur-rtde's receive interface holds the interpreter
lock and waits forever; after the connection is lost, its getters keep returning the last values. Both are
harmless in a separate process: it can be ended, and the controller's time in the state shows how old a sample
is.

Control: when ur-rtde's control interface loses its connection it reconnects, and crashes with a segmentation
fault (ur-rtde 1.6.5). The process therefore exits as soon as the arm's state is too old, before the interface
notices the loss. Each line on the socket is {"number": n, "call": name, "arguments": [...]}; each answer is
{"number": n, "value": ...} or {"number": n, "error": text}. Answer 0 reports that the process is ready.
Between calls the process kicks the controller's watchdog: if the process ends, the program on the
controller stops the arm within one period of `WATCHDOG_HZ`. If its parent ends, or does not poll the arm
during a motion (`drivers.ur5e.heartbeat`), the process stops the arm itself.
"""

import faulthandler
import json
import math
import os
import select
import socket
import sys
import threading
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

from drivers.clock import NS_PER_S, Clock, SystemClock, host_s, require_full_speed, to_ns
from drivers.realtime import ask_for_realtime, ordinary
from drivers.ur5e.heartbeat import BRAKE_M_S2, Heartbeat, Program
from drivers.ur5e.shared_state import SharedState, StateSample

KICK_S = 0.02
"""Interval at which the controller's watchdog is kicked."""
WATCHDOG_HZ = 12.5
"""Lowest rate of kicks: after 80 ms without one the controller ends the program."""


class ControlCommands:
    """The calls. `control` is ur-rtde's `RTDEControlInterface`, which has no type hints.

    Poses are x y z in m and a rotation vector in rad. A result of False: the controller rejected the command.
    """

    def __init__(self, control: Any, heartbeat: Heartbeat, clock: Clock) -> None:
        self._control, self.heartbeat, self._clock = control, heartbeat, clock
        self._guided = False
        self._kick_ns: int | None = None
        """When the controller's watchdog is kicked next; None before it was started."""

    def supervise(self) -> None:
        """Kick the controller's watchdog if due; stop a motion whose program no longer polls the arm."""
        if self._kick_ns is not None and self._clock.now_ns() >= self._kick_ns:
            self._kick_ns = self._clock.now_ns() + to_ns(KICK_S)
            if self._control.isProgramRunning():
                self._control.kickWatchdog()
        self.heartbeat.check()

    def tcp(self) -> Sequence[float]:
        return self._control.getTCPOffset()

    def set_tcp(self, flange_tcp: Sequence[float]) -> tuple[bool, Sequence[float]]:
        """Set the TCP (x y z in m, rotation vector in rad); also return the TCP that is set afterwards."""
        return self._control.setTcp(flange_tcp), self._control.getTCPOffset()

    def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> bool:
        return self._control.setPayload(mass_kg, cog_m)

    def start_watchdog(self) -> bool:
        """From now on the controller ends the program, and so the motion, after 80 ms without a kick."""
        started = self._control.setWatchdog(WATCHDOG_HZ)
        self._kick_ns = self._clock.now_ns() if started else None
        return started

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
        self.heartbeat.begin(speed_m_s)
        return self._control.moveL(pose, speed_m_s, acceleration_m_s2, True), before

    def operation(self) -> tuple[int, bool, str]:
        """Return number and running of the newest operation, and the `halt_reason` of the heartbeat."""
        status = self._control.getAsyncOperationProgressEx()
        return status.operationId(), status.isAsyncOperationRunning(), self.heartbeat.halted

    def stop_linear(self, deceleration_m_s2: float) -> None:
        """Start braking along the path; if the arm is led by hand, guiding is ended first."""
        self.heartbeat.end()
        if self._guided:
            self.end_guiding()
        self._control.stopL(deceleration_m_s2, True)

    def begin_guiding(self) -> bool:
        """Let a person lead the arm by hand (URScript teach_mode)."""
        self._guided = True
        self.heartbeat.begin(None)
        return self._control.teachMode()

    def end_guiding(self) -> bool:
        """Return to position control (URScript end_teach_mode)."""
        self.heartbeat.end()
        self._guided = False
        return self._control.endTeachMode()

    def halt_reason(self) -> str:
        """Return why `drivers.ur5e.heartbeat` ended the newest motion or guiding; empty if it did not."""
        return self.heartbeat.halted

    def zero_force_sensor(self) -> bool:
        return self._control.zeroFtSensor()

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for half a second."""
        return self._control.isSteady()

    def end_program(self) -> None:
        self._control.stopScript()


STATE_LIMIT_S = 0.6
"""Age of the arm's state at which the command process exits; ur-rtde reconnects after 2.5 s."""
WATCH_S = 0.05
"""Interval between checks of the state's age and of the parent process."""
TICK_S = 0.005
"""Longest wait for a call between two checks of the heartbeat."""
STOP_S = 1.0
"""Time for the arm to stop before the command process exits because its parent ended."""
STATE_LOST, PARENT_LOST, CONNECTION_LOST = 3, 4, 3
"""Exit codes: of the command process, and of the state process."""
AT_ONCE = ("stop_linear", "end_program", "operation", "halt_reason")
"""Calls that stop the arm or need no answer of the controller; they keep the real-time priority."""
COMMANDS = {name: method for name, method in vars(ControlCommands).items() if not name.startswith("_")}


def serve(connection: socket.socket, commands: ControlCommands, clock: Clock) -> None:
    """Answer calls until the client closes the connection; then nobody supervises the arm, so stop it."""
    lines, tick_s = connection.makefile("rb"), host_s(clock, TICK_S)
    while True:
        commands.supervise()
        if not select.select([connection], [], [], tick_s)[0]:
            continue
        line = lines.readline()
        if not line:
            answer(commands, {"call": "stop_linear", "arguments": [BRAKE_M_S2]})
            return
        asked_ns, request = clock.now_ns(), json.loads(line)
        # while ur-rtde waits for the controller it busy-waits, and would take the core from everything else
        with nullcontext() if request["call"] in AT_ONCE else ordinary():
            reply = answer(commands, request)
        _send(connection, reply)
        commands.heartbeat.note_answer(asked_ns)


def answer(commands: ControlCommands, request: dict[str, Any]) -> dict[str, Any]:
    """Execute one call. An error of the library is also an answer."""
    number = request.get("number")
    try:
        return {"number": number, "value": COMMANDS[request["call"]](commands, *request["arguments"])}
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


POLL_S = 0.0004
"""Interval at which ur-rtde is asked for a new state: shorter than the 2 ms between states."""
OFFSET_BLOCK_S = 10.0
"""The clock offset is the minimum over this block and the previous one."""
VARIABLES = (
    "timestamp",
    "actual_q",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "robot_mode",
    "safety_status_bits",
    "robot_status_bits",
    "runtime_state",
    "target_speed_fraction",
)


class ClockMap:
    """Converts the controller's time to the computer's monotonic clock.

    A package can arrive late but never early. So the smallest difference of the last 10 to 20 s is closest to
    the true offset, and it follows slow drift between the clocks.
    """

    def __init__(self) -> None:
        self._block_start_ns: int | None = None
        self._before = self._current = sys.maxsize

    def to_host_ns(self, controller_ns: int, received_ns: int) -> int:
        """Return the monotonic time in ns at which the controller took a sample."""
        offset = received_ns - controller_ns
        if self._block_start_ns is None or received_ns - self._block_start_ns > to_ns(OFFSET_BLOCK_S):
            self._block_start_ns = received_ns
            self._before, self._current = self._current, offset
        self._current = min(self._current, offset)
        return controller_ns + min(self._before, self._current)


def listen(
    receive: Any, state: SharedState, parent_pid: int, rate_hz: float, with_payload: bool, clock: Clock
) -> None:
    """Publish each new sample until the connection is lost or the parent process has ended."""
    times = ClockMap()
    last_s = -math.inf
    samples = gaps = 0
    while receive.isConnected() and os.getppid() == parent_pid:
        timestamp_s = receive.getTimestamp()
        if timestamp_s == last_s:
            clock.sleep_until(clock.now_ns() + to_ns(POLL_S))
            continue
        received_ns = clock.now_ns()
        gaps += max(0, round((timestamp_s - last_s) * rate_hz) - 1) if samples else 0
        samples, last_s = samples + 1, timestamp_s
        sampled_ns = times.to_host_ns(round(timestamp_s * NS_PER_S), received_ns)
        state.write(
            StateSample(
                timestamp_s,
                received_ns,
                sampled_ns,
                *(tuple(receive.getActualQ()), tuple(receive.getActualTCPPose())),  # type: ignore[arg-type]
                *(tuple(receive.getActualTCPSpeed()), tuple(receive.getActualTCPForce())),  # type: ignore[arg-type]
                payload_kg=receive.getPayload() if with_payload else math.nan,
                payload_cog_m=tuple(receive.getPayloadCog()) if with_payload else (math.nan,) * 3,  # type: ignore[arg-type]
                speed_fraction=receive.getTargetSpeedFraction(),
                robot_mode=receive.getRobotMode(),
                safety_bits=receive.getSafetyStatusBits(),
                status_bits=receive.getRobotStatus(),
                runtime_state=receive.getRuntimeState(),
                samples=samples,
                gaps=gaps,
            )
        )


def run_state(
    host: str, state: SharedState, parent_pid: int, clock: Clock, rate_hz: str, with_payload: str
) -> int:
    """Connect and receive states; return the exit code."""
    reports = with_payload == "1"
    variables = [*VARIABLES, "payload", "payload_cog"] if reports else list(VARIABLES)
    try:
        from rtde_receive import RTDEReceiveInterface

        ask_for_realtime()
        receive = RTDEReceiveInterface(host, float(rate_hz), variables)
    except (ImportError, RuntimeError, ValueError) as error:
        sys.exit(" ".join(str(error).split()))
    faulthandler.cancel_dump_traceback_later()
    listen(receive, state, parent_pid, float(rate_hz), reports, clock)
    if last := state.read():
        state.write(replace(last, received_ns=0))  # older than any limit: the state is unknown from now on
    return CONNECTION_LOST


def run_control(host: str, state: SharedState, parent_pid: int, clock: SystemClock, socket_fd: str) -> int:
    """Connect, report that the process is ready, and serve calls; return the exit code."""
    threading.Thread(target=watch, args=(state, parent_pid, clock), daemon=True).start()
    connection = socket.socket(fileno=int(socket_fd))
    try:
        from rtde_control import RTDEControlInterface

        ask_for_realtime()
        control = RTDEControlInterface(host)
    except (ImportError, RuntimeError, ValueError) as error:
        _send(connection, {"number": 0, "error": str(error)})
        return 0
    faulthandler.cancel_dump_traceback_later()
    _send(connection, {"number": 0, "value": "ready"})
    heartbeat = Heartbeat(control, state, Program(parent_pid, clock.slowness), clock)
    serve(connection, ControlCommands(control, heartbeat, clock), clock)
    return 0


def _send(connection: socket.socket, answered: dict[str, Any]) -> None:
    connection.sendall(json.dumps(answered).encode() + b"\n")


KINDS = {"state": (5.0, run_state), "control": (10.0, run_control)}
"""Time limits, s, for ur-rtde to connect, and to upload its program; then the process exits."""


def main(kind: str, host: str, state_fd: str, parent_pid: str, slowness: str, *own: str) -> None:
    """Run one of the processes. slowness: of the clock of all limits."""
    clock = SystemClock(int(slowness))
    require_full_speed(clock, "arm", host)
    limit_s, run = KINDS[kind]
    faulthandler.dump_traceback_later(host_s(clock, limit_s), exit=True)  # works while the GIL is held
    code = run(host, SharedState(int(state_fd)), int(parent_pid), clock, *own)
    sys.stdout.flush()
    os._exit(code)  # the destructors of the interfaces take half a second and have nothing left to do


if __name__ == "__main__":
    main(*sys.argv[1:])
