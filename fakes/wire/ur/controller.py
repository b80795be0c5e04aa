"""A simulated UR5e controller on the ports of a real one, for the real client libraries.

30004 is the real-time data exchange, 29999 the dashboard; 30001 to 30003 receive programs. The clients fix
the ports, so each controller needs its own address: 127.0.0.1, 127.0.0.2, ... Its connections read and write
without ever waiting for a client.

It must not run in the process of a ur-rtde client: the constructors of that client hold the interpreter lock
while they wait for the controller's answer.
"""

import contextlib
import logging
import math
import os
import re
import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from drivers.clock import NS_PER_S, Clock, host_s
from drivers.errors import InputError
from drivers.types import Vector6
from fakes.faults import Faults
from fakes.wire.net import Part
from fakes.wire.ur.control_loop import ControlLoop
from fakes.wire.ur.robot import CYCLE_NS, Robot
from fakes.wire.ur.rtde import RtdeSession
from fakes.wire.ur.script import BANNER, LineReader, ProgramReader, control_program, reply, run_other
from fakes.world.kinematics import PHYSICAL_TOOL, compose, from_ur, rotation_between
from fakes.world.world import World

GIVE_UP_S = 10.0
"""A client that does not read is dropped after about this time (users' reports)."""
RECEIVE_BYTES = SEND_BYTES = 65536
MOST_PENDING = 1 << 20
"""A client that leaves more bytes of answers unread than this is dropped."""
MOST_CLIENTS = 100
"""Simultaneous connections; all fakes of a process share a thousand file descriptors."""
Feed = Callable[[bytes], bytes]


@dataclass(slots=True, eq=False)
class Connection:
    """One client. feed: returns the answer to received bytes, raises `InputError` for invalid ones."""

    socket: socket.socket
    port: int
    feed: Feed
    session: RtdeSession | None = None
    pending: bytes = b""
    blocked_ns: int | None = None
    last: bytes = b""
    closed: bool = False

    def receive(self) -> bytes | None:
        """Return the received bytes, None if the client is gone."""
        try:
            return self.socket.recv(RECEIVE_BYTES) or None
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            return None

    def send(self, data: bytes, time_ns: int, droppable: bool = False) -> None:
        """Send what the socket takes and keep the rest. While it is full, droppable data is discarded."""
        self.pending += b"" if self.pending and droppable else data
        try:
            sent = self.socket.send(self.pending) if self.pending else 0
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError:
            self.closed = True
            return
        self.pending = self.pending[sent:]
        if not self.pending:
            self.blocked_ns = None
        elif self.blocked_ns is None or sent:
            self.blocked_ns = time_ns
        elif time_ns - self.blocked_ns > GIVE_UP_S * 1e9:
            self.closed = True
        self.closed |= len(self.pending) > MOST_PENDING


RTDE_PORT, DASHBOARD_PORT, REALTIME_PORT = 30004, 29999, 30003
SCRIPT_PORTS = (30001, 30002, REALTIME_PORT)
TOO_LATE_NS = 250_000_000
"""Cycles missed by more than this are skipped, not caught up."""
STOOD_STILL_NS = 20_000_000
"""Missed time that does not count for the watchdog: a quarter of the time after which it ends the program."""
POLYSCOPE = "5.11.0"
"""The version that is announced by default."""
BUILDS = {(5, 11): 108249}
FAULTS: dict[str, dict[str, Any]] = {
    "protective_stop": {},
    "emergency_stop": {},
    "program_killed": {},
    "stream_frozen": {"repeat": False},
    "socket_dropped": {},
    "silent": {},
    "remote_control_off": {},
    "recipe_refused": {"reply": "IN_USE", "prefix": ""},
}
"""Kinds of fault and the defaults of their arguments.

protective_stop: the arm stops itself; a release over the dashboard ends it, 5 s later at the earliest.
emergency_stop: the button is pressed; "clear" turns it out again, and the power stays off. program_killed:
the running program ends, as from the pendant's stop button. stream_frozen: no more data packages are sent,
or, if `repeat` is set, the same one again and again. socket_dropped: all connections are closed; new ones are
accepted. silent: connections are accepted on any port, but nothing is answered. remote_control_off: the
pendant is switched to local, so that no program is accepted. recipe_refused: variables that begin with
`prefix` are refused with `reply`, NOT_FOUND or IN_USE.
"""
_log = logging.getLogger(__name__)


class URController(Part):
    """The controller, in a thread of the hosting process.

    clock: the world's time. version: the announced version, "5.11.0" or later. release_after_s: time until a
    protective stop can be released.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        host: str = "127.0.0.1",
        version: str = POLYSCOPE,
        release_after_s: float = 5.0,
    ) -> None:
        super().__init__(f"simulated controller on {host}", self._serve)
        self.host, self._clock = host, clock
        if not re.fullmatch(r"5\.\d{1,3}\.\d{1,3}", version):
            raise InputError(
                f"controller version '{version}': an e-Series arm's is written as 5.11.0 or 5.25.0"
            )
        major, minor, bugfix = (int(part) for part in version.split("."))
        self.robot = Robot(
            world, (major, minor, bugfix, BUILDS.get((major, minor), 1_000_000 + minor)), release_after_s
        )
        self.faults = Faults("simulated controller", FAULTS, lambda: self.robot.time_ns)
        self._listeners: dict[int, socket.socket] = {}
        self._selector = selectors.SelectSelector()
        self._connections: list[Connection] = []
        self._lock = threading.RLock()

        self._cycle = self._skipped = 0
        self._cpu_s = 0.0

    def start(self) -> None:
        """Listen and run. Raises `InputError` if a port is in use or the address is not of this computer."""
        for port in (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS):
            try:
                listener = self._listeners[port] = socket.create_server((self.host, port), backlog=16)
            except OSError as error:
                self.stop()
                why = os.strerror(error.errno or 0)
                raise InputError(
                    f"simulated controller: cannot listen on {self.host} port {port}: {why}; "
                    "its ports are fixed: give each controller its own address (127.0.0.2) or stop the other"
                ) from error
            listener.setblocking(False)
            self._selector.register(listener, selectors.EVENT_READ, port)
        self._cycle = self._clock.now_ns() // CYCLE_NS
        super().start()

    def stop(self) -> None:
        super().stop()
        for connection in self._connections:
            connection.closed = True
        self._remove_closed()
        for listener in self._listeners.values():
            listener.close()
        self._selector.close()

    def inject(self, kind: str, **arguments: Any) -> None:
        """Start a fault of `FAULTS`, or end all with "clear". Raises `InputError` for an unknown one."""
        if arguments.get("reply", "IN_USE") not in ("IN_USE", "NOT_FOUND"):
            raise InputError("simulated controller: recipe_refused takes reply='NOT_FOUND' or 'IN_USE'")
        robot = self.robot
        with self._lock:
            self.faults.inject(kind, **arguments)
            match kind:
                case "clear":
                    robot.safety.release_button()
                case "protective_stop":
                    robot.safety.protective_stop(robot.time_ns)
                case "emergency_stop":
                    robot.safety.emergency_stop()
                case "program_killed":
                    robot.end_program("killed")
                case "socket_dropped":  # the serving thread then closes them
                    for connection in self._connections:
                        with contextlib.suppress(OSError):
                            connection.socket.shutdown(socket.SHUT_RDWR)
            self._set_remote_control()

    def _set_remote_control(self) -> None:
        self.robot.safety.remote_control = self.faults.get("remote_control_off") is None

    def guide(self, to: Vector6, total_s: float) -> None:
        """Push the tool to a pose in the controller's notation within `total_s`, as a person's hand does.

        The arm follows only in teach mode. Raises `InputError` for an invalid pose or time.
        """
        if not all(map(math.isfinite, to)) or not 0.1 <= total_s <= 60.0:
            raise InputError(f"a hand leads to a pose over 0.1 to 60 s, not to {to} over {total_s}")
        with self._lock:
            here, there = compose(self.robot.body.flange, PHYSICAL_TOOL), from_ur(to)
            x, y, z = (b - a for a, b in zip(here[:3], there[:3], strict=True))
            self.robot.hand.lead((x, y, z, *rotation_between(here, there)), total_s)

    def snapshot(self) -> dict[str, Any]:
        with self._lock:
            robot, sessions = self.robot, [c.session for c in self._connections if c.session is not None]
            return {
                "host": self.host,
                "version": ".".join(map(str, robot.version[:3])),
                "cycles": self._cycle,
                "skipped_cycles": self._skipped,
                "cpu_s": self._cpu_s,
                "clients": len(self._connections),
                "streams": sum(session.started for session in sessions),
                "ignored_packages": sum(session.ignored for session in sessions),
                "commands": {str(number): n for number, n in sorted(robot.commands.items())},
                "program_running": robot.runtime.running,
                "program_end": robot.runtime.last_error,
                "safety_mode": robot.safety.mode.name,
                "robot_mode": robot.safety.robot_mode.name,
                "remote_control": robot.safety.remote_control,
                "tcp_m": list(robot.body.tcp[:3]),
                "freedrive": robot.body.mover is robot.hand,
            }

    def _serve(self) -> None:
        while not self.stopping.is_set():
            wait_ns = (self._cycle + 1) * CYCLE_NS - self._clock.now_ns()
            self._selector.select(host_s(self._clock, max(wait_ns, 0) / NS_PER_S))
            with self._lock:
                self.robot.heard_ns = now_ns = self._clock.now_ns()
                # asked again: what arrived while this thread had no core is heard before the missed cycles
                for key, _ in self._selector.select(0):
                    if isinstance(key.data, int):
                        self._accept(key.data)
                    elif not key.data.closed:
                        self._receive(key.data)
                self._catch_up(now_ns // CYCLE_NS)

    def _catch_up(self, due: int) -> None:
        missed_ns = (due - 1 - self._cycle) * CYCLE_NS
        if missed_ns > STOOD_STILL_NS:
            self.robot.runtime.stood_still(missed_ns, due * CYCLE_NS)
        if missed_ns > TOO_LATE_NS:
            self._skipped += due - 1 - self._cycle
            self._cycle = due - 1
        while self._cycle < due:
            self._cycle += 1
            self.robot.cycle(self._cycle * CYCLE_NS)
            self._set_remote_control()
            self._publish()
        if self._cycle % 64 == 0:
            self._cpu_s = time.thread_time()

    def _publish(self) -> None:
        frozen = self.faults.get("stream_frozen")
        if self._silent or (frozen is not None and not frozen["repeat"]):
            return
        for connection in self._connections:
            if connection.session is not None and connection.session.due(self._cycle):
                if not (connection.pending or (frozen and connection.last)):
                    connection.last = connection.session.data()
                connection.send(connection.last, self.robot.time_ns, droppable=True)
        self._remove_closed()

    def _accept(self, port: int) -> None:
        try:
            client, _ = self._listeners[port].accept()
        except OSError:  # it has disconnected already
            return
        if len(self._connections) >= MOST_CLIENTS:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        connection = Connection(client, port, lambda _: b"")
        greeting = b""
        if port == RTDE_PORT:
            session = RtdeSession(self.robot.bank, self.robot.version, self.robot.write_inputs, self._refusal)
            connection.session, connection.feed = session, session.feed
        elif port == DASHBOARD_PORT:
            connection.feed, greeting = partial(self._feed_dashboard, LineReader()), BANNER.encode() + b"\n"
        else:
            connection.feed = partial(self._feed_script, ProgramReader())
        self._connections.append(connection)
        self._selector.register(client, selectors.EVENT_READ, connection)
        if not self._silent:
            connection.send(greeting, self.robot.time_ns)

    def _refusal(self, variable: str) -> str | None:
        """Return how a recipe with this variable is refused, None if it is not."""
        refusal = self.faults.get("recipe_refused")
        return refusal["reply"] if refusal and variable.startswith(refusal["prefix"]) else None

    @property
    def _silent(self) -> bool:
        return self.faults.get("silent") is not None

    def _feed_dashboard(self, reader: LineReader, data: bytes) -> bytes:
        return "".join(reply(self.robot, line) + "\n" for line in reader.feed(data)).encode()

    def _feed_script(self, reader: ProgramReader, data: bytes) -> bytes:
        for text in reader.feed(data):
            if self.robot.safety.remote_control:
                ours, robot = control_program(text), self.robot
                program = run_other(robot, text) if ours is None else ControlLoop(robot, *ours).run()
                robot.run(program, len(text))
        return b""

    def _receive(self, connection: Connection) -> None:
        data = connection.receive()
        if data is None:
            connection.closed = True
        elif data and not self._silent:
            try:
                connection.send(connection.feed(data), self.robot.time_ns)
            except InputError as error:
                _log.warning("simulated controller, port %d: %s", connection.port, error)
                connection.closed = True
        self._remove_closed()

    def _remove_closed(self) -> None:
        for connection in [c for c in self._connections if c.closed]:
            self._connections.remove(connection)
            self._selector.unregister(connection.socket)
            connection.socket.close()
