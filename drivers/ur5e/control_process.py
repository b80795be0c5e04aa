"""The process that commands the arm: ur-rtde's control interface behind a few named calls.

The interface reconnects by itself when its connection is lost, and dies of it (a segmentation
fault, ur-rtde 1.6.5). So it lives in a process of its own, which ends itself as soon as the arm's
state gets old, before the interface would notice.

    python -m drivers.ur5e.control_process HOST SOCKET_FD BOARD_FD PARENT_PID

Each line on the socket is {"call": name, "args": [...]}, each answer {"value": ...} or
{"error": text}. While nothing is asked it keeps the controller's watchdog quiet: should this
process end, the program on the controller stops the arm within `WATCHDOG_HZ`'s period.
"""

import faulthandler
import json
import os
import select
import socket
import sys
import threading
from collections.abc import Callable
from typing import Any

from drivers.clock import SystemClock, to_ns
from drivers.realtime import ask_for_realtime
from drivers.ur5e.shared_state import SharedState

START_LIMIT_S = 10.0
STATE_LIMIT_S = 0.6
"""Age of the arm's state at which this process gives up; ur-rtde reconnects after 2.5 s."""
WATCH_S = 0.05
WATCHDOG_HZ = 2.0
STATE_LOST, PARENT_LOST = 3, 4
Call = Callable[..., Any]


def calls(control: Any, watchdog: "Watchdog") -> dict[str, Call]:
    """What can be asked for, by name."""
    return {
        "tcp": lambda pose: [control.setTcp(pose), control.getTCPOffset()],
        "payload": control.setPayload,
        "watchdog": watchdog.begin,
        "plan": lambda pose, near: _plan(control, pose, near),
        "move": lambda pose, speed, acceleration: _move(control, pose, speed, acceleration),
        "progress": lambda: _progress(control),
        "stop": lambda deceleration: control.stopL(deceleration, True),
        "zero_ft": control.zeroFtSensor,
        "steady": control.isSteady,
        "end": control.stopScript,
    }


def _plan(control: Any, pose: list[float], near: list[float]) -> list[float] | None:
    """Joints that reach a pose, None when it is out of the safety limits or of reach.

    The limits are asked first: an inverse without a solution ends the program on the controller.
    """
    if not control.isPoseWithinSafetyLimits(pose):
        return None
    return control.getInverseKinematics(pose, near)


def _move(control: Any, pose: list[float], speed: float, acceleration: float) -> list:
    """Start moving; returns whether the controller took it, and the operation that came before."""
    before = control.getAsyncOperationProgressEx().operationId()
    return [control.moveL(pose, speed, acceleration, True), before]


def _progress(control: Any) -> list:
    status = control.getAsyncOperationProgressEx()
    return [status.operationId(), status.isAsyncOperationRunning()]


class Watchdog:
    """Keeps the controller's watchdog quiet from the moment it was asked for."""

    def __init__(self, control: Any) -> None:
        self._control = control
        self._clock = SystemClock()
        self._next_ns: int | None = None

    def begin(self) -> bool:
        """Ask for it: from now on the program ends when nothing is written for half a second."""
        begun = self._control.setWatchdog(WATCHDOG_HZ)
        self._next_ns = self._clock.now_ns() if begun else None
        return begun

    def feed(self) -> None:
        """Write something, if it is time."""
        if self._next_ns is not None and self._clock.now_ns() >= self._next_ns:
            self._next_ns = self._clock.now_ns() + to_ns(WATCH_S)
            if self._control.isProgramRunning():
                self._control.kickWatchdog()


def serve(connection: socket.socket, table: dict[str, Call], watchdog: Watchdog) -> None:
    """Answer until the other side hangs up."""
    lines = connection.makefile("rb")
    while True:
        watchdog.feed()
        if not select.select([connection], [], [], WATCH_S)[0]:
            continue
        line = lines.readline()
        if not line:
            return
        connection.sendall(json.dumps(_answer(table, json.loads(line))).encode() + b"\n")


def _answer(table: dict[str, Call], request: dict[str, Any]) -> dict[str, Any]:
    try:
        return {"value": table[request["call"]](*request["args"])}
    except (RuntimeError, ValueError, TypeError, IndexError) as error:  # what pybind makes of C++ exceptions
        return {"error": str(error)}


def watch(board: SharedState, parent_pid: int) -> None:
    """End this process when the arm's state gets old or the parent is gone."""
    clock = SystemClock()
    while True:
        clock.sleep_until(clock.now_ns() + to_ns(WATCH_S))
        sample = board.read()
        if sample is None or clock.now_ns() - sample.received_ns > to_ns(STATE_LIMIT_S):
            os._exit(STATE_LOST)
        if os.getppid() != parent_pid:
            os._exit(PARENT_LOST)


def main(host: str, socket_fd: int, board_fd: int, parent_pid: int) -> None:
    """Connect, say so, and serve."""
    ask_for_realtime()
    faulthandler.dump_traceback_later(START_LIMIT_S, exit=True)  # runs although the constructor keeps the GIL
    threading.Thread(target=watch, args=(SharedState(board_fd), parent_pid), daemon=True).start()
    connection = socket.socket(fileno=socket_fd)
    try:
        from rtde_control import RTDEControlInterface

        control = RTDEControlInterface(host)
    except (ImportError, RuntimeError, ValueError) as error:
        connection.sendall(json.dumps({"error": str(error)}).encode() + b"\n")
        return
    faulthandler.cancel_dump_traceback_later()
    connection.sendall(json.dumps({"value": "ready"}).encode() + b"\n")
    watchdog = Watchdog(control)
    serve(connection, calls(control, watchdog), watchdog)
    sys.stdout.flush()
    os._exit(0)  # the interface's destructor takes half a second and has nothing left to do


if __name__ == "__main__":
    _, _host, _socket, _board, _parent = sys.argv
    main(_host, int(_socket), int(_board), int(_parent))
