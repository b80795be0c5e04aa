"""A simulated UR5e controller on its own ports: what the real client libraries talk to.

30004 real-time data exchange, 29999 dashboard, 30003/30002/30001 client interfaces (programs in,
states out). Ports are fixed in the clients, so each controller needs an address: 127.0.0.1,
127.0.0.2, ...

It must not live in the process of a ur-rtde client: that client's constructors keep the
interpreter to themselves, and the answer they wait for would never come.
"""

import logging
import math
import re
import selectors
import threading
import time
from typing import Any

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from drivers.types import Vector6
from fakes.wire.net.background import VitalThread
from fakes.wire.ur.client_interfaces import (
    PRIMARY_CYCLES,
    REALTIME_CYCLES,
    StateStream,
    realtime_state,
    robot_state,
    version_message,
)
from fakes.wire.ur.commands import COMMANDS
from fakes.wire.ur.connections import MOST_CLIENTS, Connection, Feed, Listeners
from fakes.wire.ur.control_loop import ControlLoop
from fakes.wire.ur.dashboard import BANNER, DashboardServer, LineReader
from fakes.wire.ur.faults import Faults
from fakes.wire.ur.frames import compose, from_ur, rotation_between
from fakes.wire.ur.guiding import Guided
from fakes.wire.ur.robot import CYCLE_NS, PHYSICAL_TOOL, Robot
from fakes.wire.ur.rtde import RtdeSession
from fakes.wire.ur.script import ControlProgram, ProgramReader, ScriptProgram, recognise
from fakes.wire.ur.user_programs.run import ScriptRun
from fakes.wire.ur.variables import Version
from fakes.world.world import World

RTDE_PORT, DASHBOARD_PORT, REALTIME_PORT = 30004, 29999, 30003
SCRIPT_PORTS = (30001, 30002, REALTIME_PORT)
Stream = RtdeSession | StateStream
TOO_LATE_NS = 250_000_000
"""Cycles missed by more than this are skipped, not caught up."""
POLYSCOPE = "5.11.0"
"""The version that is announced unless another is asked for."""
BUILDS = {(5, 11): 108249}
JOIN_S = 2.0
_log = logging.getLogger(__name__)


class URController:
    """The controller, in a thread of the hosting process.

    clock: the world's time. version: what it says it runs, "5.11.0" or later. release_after_s:
    how soon a protective stop can be released.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        host: str = "127.0.0.1",
        version: str = POLYSCOPE,
        serial_number: str = "20265500001",
        release_after_s: float = 5.0,
    ) -> None:
        self.host = host
        self._clock = clock
        self.robot = Robot(world, _version(version), release_after_s)
        self.faults = Faults(self.robot, self._drop)
        self._dashboard = DashboardServer(self.robot, serial_number, self._run)
        self._listeners = Listeners(host, (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS))
        self._selector = selectors.SelectSelector()
        self._connections: list[Connection] = []
        self._streams: dict[Connection, Stream] = {}
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._thread: VitalThread | None = None
        self._cycle = self._skipped = 0
        self._cpu_s = 0.0
        self._program: ControlLoop | ScriptRun | None = None

    def start(self) -> None:
        """Listen and run. Raises `InputError` when a port is taken."""
        self._listeners.open()
        for port, listener in self._listeners.sockets.items():
            self._selector.register(listener, selectors.EVENT_READ, port)
        self._cycle = self._clock.now_ns() // CYCLE_NS
        self._stopping.clear()
        self._thread = VitalThread(self._serve, f"simulated controller on {self.host}")
        self._thread.start()

    @property
    def failure(self) -> Exception | None:
        """What ended the controller by itself; None where nothing did."""
        return self._thread.failure if self._thread else None

    def stop(self) -> None:
        """Close everything. Safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        for connection in self._connections:
            connection.closed = True
        self._bury()
        self._listeners.close()
        self._selector.close()
        self._selector = selectors.SelectSelector()

    def inject(self, kind: str, **arguments: Any) -> None:
        """Begin a fault (`fakes.wire.ur.faults.KINDS`). Raises `InputError` for an unknown one."""
        self.faults.check(kind, arguments)
        with self._lock:
            self.faults.begin(kind, arguments)

    def guide(self, to: Vector6, total_s: float) -> None:
        """Have a person's hand lead the tool to a pose, in the controller's notation, over so long.

        The arm gives way in freedrive alone. Raises `InputError` for what no hand does.
        """
        if not all(map(math.isfinite, to)) or not 0.1 <= total_s <= 60.0:
            raise InputError(f"a hand leads to a pose over 0.1 to 60 s, not to {to} over {total_s}")
        with self._lock:
            here, there = compose(self.robot.body.flange, PHYSICAL_TOOL), from_ur(to)
            x, y, z = (b - a for a, b in zip(here[:3], there[:3], strict=True))
            self.robot.hand.lead((x, y, z, *rotation_between(here, there)), total_s)

    def snapshot(self) -> dict[str, Any]:
        """What has happened so far, in JSON values."""
        with self._lock:
            robot = self.robot
            sessions = [s for s in self._streams.values() if isinstance(s, RtdeSession)]
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
                "program_running": robot.running,
                "program_end": robot.last_error,
                "skipped_lines": self._program.skipped if isinstance(self._program, ScriptRun) else [],
                "safety_mode": robot.safety.mode.name,
                "robot_mode": robot.safety.robot_mode.name,
                "remote_control": robot.safety.remote_control,
                "tcp_m": list(robot.body.tcp[:3]),
                "freedrive": isinstance(robot.body.mover, Guided),
            }

    def _serve(self) -> None:
        while not self._stopping.is_set():
            wait_ns = (self._cycle + 1) * CYCLE_NS - self._clock.now_ns()
            ready = self._selector.select(max(wait_ns, 0) / NS_PER_S)
            with self._lock:
                self.robot.heard_ns = self._clock.now_ns()
                for key, _ in ready:
                    self._attend(key.data)
                self._catch_up()

    def _catch_up(self) -> None:
        due = self._clock.now_ns() // CYCLE_NS
        if (due - self._cycle) * CYCLE_NS > TOO_LATE_NS:
            self._skipped += due - 1 - self._cycle
            self._cycle = due - 1
        while self._cycle < due:
            self._cycle += 1
            self.faults.step(self._cycle * CYCLE_NS)
            self.robot.cycle(self._cycle * CYCLE_NS)
            self._publish()
        if self._cycle % 64 == 0:
            self._cpu_s = time.thread_time()

    def _publish(self) -> None:
        faults, time_ns = self.faults, self.robot.time_ns
        if faults.silent or (faults.frozen and not faults.repeat):
            return
        for connection, stream in self._streams.items():
            if stream.due(self._cycle):
                if not (connection.behind or (faults.frozen and connection.last)):
                    connection.last = stream.data()
                connection.send(connection.last, time_ns, droppable=True)
        self._bury()

    def _attend(self, what: int | Connection) -> None:
        if isinstance(what, int):
            self._welcome(what)
        elif not what.closed:
            self._hear(what)

    def _welcome(self, port: int) -> None:
        client = self._listeners.accept(port)
        if client is None:
            return
        if len(self._connections) >= MOST_CLIENTS:
            client.close()
            return
        feed, stream, greeting = self._service(port)
        connection = Connection(client, port, feed, patient=port in SCRIPT_PORTS)
        self._connections.append(connection)
        self._selector.register(client, selectors.EVENT_READ, connection)
        if stream is not None:
            self._streams[connection] = stream
        if not self.faults.silent:
            connection.send(greeting, self.robot.time_ns)

    def _service(self, port: int) -> tuple[Feed, Stream | None, bytes]:
        """What takes a client's bytes, what it is sent over and over, and what it is greeted with."""
        robot = self.robot
        if port == RTDE_PORT:
            session = RtdeSession(robot.bank, robot.version, robot.write_inputs, self.faults.refused)
            return session.feed, session, b""
        if port == DASHBOARD_PORT:
            lines = LineReader()

            def answer(data: bytes) -> bytes:
                return "".join(self._dashboard.reply(t) + "\n" for t in lines.feed(data)).encode()

            return answer, None, BANNER.encode() + b"\n"
        programs = self._take_programs(ProgramReader())
        if port == REALTIME_PORT:
            return programs, StateStream(REALTIME_CYCLES, lambda: realtime_state(robot)), b""
        return programs, StateStream(PRIMARY_CYCLES, lambda: robot_state(robot)), version_message(robot)

    def _take_programs(self, reader: ProgramReader) -> Feed:
        def feed(data: bytes) -> bytes:
            for text in reader.feed(data):
                if self.robot.safety.remote_control:
                    self._run(recognise(text), len(text))
            return b""

        return feed

    def _run(self, program: ControlProgram | ScriptProgram, characters: int = 0) -> bool:
        if isinstance(program, ControlProgram):
            run = ControlLoop(self.robot, program, COMMANDS)
        else:
            run = ScriptRun(self.robot, program)
        if not self.robot.run(run, characters):
            return False
        self._program = run
        return True

    def _hear(self, connection: Connection) -> None:
        data = connection.receive()
        if data is None:
            connection.closed = True
        elif data and not self.faults.silent:
            try:
                connection.send(connection.feed(data), self.robot.time_ns)
            except InputError as error:
                _log.warning("simulated controller, port %d: %s", connection.port, error)
                connection.closed = True
        self._bury()

    def _bury(self) -> None:
        for connection in [c for c in self._connections if c.closed]:
            self._connections.remove(connection)
            self._streams.pop(connection, None)
            self._selector.unregister(connection.socket)
            connection.close()

    def _drop(self) -> None:
        with self._lock:
            for connection in self._connections:
                connection.hang_up()


def _version(text: str) -> Version:
    if not re.fullmatch(r"5\.\d{1,3}\.\d{1,3}", text):
        raise InputError(f"controller version '{text}': an e-Series arm's is written as 5.11.0 or 5.25.0")
    major, minor, bugfix = (int(part) for part in text.split("."))
    return major, minor, bugfix, BUILDS.get((major, minor), 1_000_000 + minor)
