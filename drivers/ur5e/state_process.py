"""The state process: receives the arm's states with ur-rtde and writes them to shared memory.

If the controller sends nothing, the constructor of ur-rtde's receive interface holds the interpreter lock
and waits forever; after the connection is lost, its getters keep returning the last values. Both are harmless
in a separate process: it can be ended, and the controller's time in the state shows how old a sample is.
    python -m drivers.ur5e.state_process HOST RATE_HZ STATE_FD PARENT_PID WITH_PAYLOAD SLOWNESS
"""

import faulthandler
import math
import os
import sys
from dataclasses import replace
from typing import Any, NoReturn

from drivers.clock import NS_PER_S, Clock, SystemClock, host_s, require_full_speed, to_ns
from drivers.realtime import ask_for_realtime
from drivers.ur5e.shared_state import SharedState, StateSample
from drivers.values import Vector3

START_LIMIT_S = 5.0
"""Time limit for ur-rtde to connect; then the process exits."""
POLL_S = 0.0004
"""Interval at which ur-rtde is asked for a new state: shorter than the 2 ms between states."""
OFFSET_BLOCK_S = 10.0
"""The clock offset is the minimum over this block and the previous one."""
CONNECTION_LOST = 3
"""Exit code."""
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
                *map(tuple, (receive.getActualQ(), receive.getActualTCPPose())),  # type: ignore[arg-type]
                *map(tuple, (receive.getActualTCPSpeed(), receive.getActualTCPForce())),  # type: ignore[arg-type]
                payload_kg=receive.getPayload() if with_payload else math.nan,
                payload_cog_m=_payload_cog(receive) if with_payload else (math.nan, math.nan, math.nan),
                speed_fraction=receive.getTargetSpeedFraction(),
                robot_mode=receive.getRobotMode(),
                safety_bits=receive.getSafetyStatusBits(),
                status_bits=receive.getRobotStatus(),
                runtime_state=receive.getRuntimeState(),
                samples=samples,
                gaps=gaps,
            )
        )


def _payload_cog(receive: Any) -> Vector3:
    x, y, z = receive.getPayloadCog()
    return x, y, z


def main(
    host: str, rate_hz: float, state_fd: int, parent_pid: int, with_payload: bool, slowness: int
) -> NoReturn:
    """Connect, receive states, and exit with a code that states the reason. slowness: of the clock."""
    clock = SystemClock(slowness)
    require_full_speed(clock, "arm", host)
    faulthandler.dump_traceback_later(host_s(clock, START_LIMIT_S), exit=True)  # works while the GIL is held
    variables = [*VARIABLES, "payload", "payload_cog"] if with_payload else list(VARIABLES)
    try:
        from rtde_receive import RTDEReceiveInterface

        ask_for_realtime()
        receive = RTDEReceiveInterface(host, rate_hz, variables)
    except (ImportError, RuntimeError, ValueError) as error:
        sys.exit(" ".join(str(error).split()))
    faulthandler.cancel_dump_traceback_later()
    state = SharedState(state_fd)
    listen(receive, state, parent_pid, rate_hz, with_payload, clock)
    if last := state.read():
        state.write(replace(last, received_ns=0))  # older than any limit: the state is unknown from now on
    sys.stdout.flush()
    os._exit(CONNECTION_LOST)  # the interface's destructor takes half a second and has nothing left to do


if __name__ == "__main__":
    _, _host, _rate, _fd, _parent, _payload, _slowness = sys.argv
    main(_host, float(_rate), int(_fd), int(_parent), _payload == "1", int(_slowness))
