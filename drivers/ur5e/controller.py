"""Check that the controller answers before ur-rtde connects, each step with a deadline; its dashboard.

ur-rtde's constructors wait forever if the peer accepts the connection but sends nothing. This module
negotiates the protocol and reads the controller's version on the same port, and reports errors.

The dashboard server on port 29999 answers one line per request. ur-rtde's own client waits up to 2.5 s for a
line, which is too long for a stop. Wording: Universal Robots, "Dashboard Server e-Series".
"""

import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import NS_PER_S, Clock, SystemClock, host_s, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.values import require_fraction

RTDE_PORT, SCRIPT_PORT = 30004, 30003
"""TCP ports of the controller for RTDE and for URScript (UR client interfaces)."""
PROTOCOL_VERSION = 2
"""Version of the RTDE protocol that is requested (RTDE guide)."""
SERIES = 5
"""Major version of PolyScope on an e-Series arm such as the UR5e."""
LEAST = 5, 4
"""Oldest PolyScope. For an older one ur-rtde 1.6.5 requests no output registers, and then crashes with a
segmentation fault when it reads them (measured with 5.0 to 5.3 on the simulated controller)."""
_HEADER = struct.Struct(">HB")
_VERSION, _CONTROLLER, _OUTPUTS, _START, _DATA, _TEXT = b"V", b"v", b"O", b"S", b"U", b"M"
"""Package types (Universal Robots, "RTDE Guide")."""
_TRIAL_HZ = 125.0
"""Rate at which the controller is asked to send its state during the probe."""
_LONGEST = 4096
"""Size limit of an RTDE package, bytes."""
Version = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Deadline:
    """A point in time on a clock by which an operation must finish."""

    clock: Clock
    time_ns: int

    @classmethod
    def after(cls, timeout_s: float, clock: Clock) -> "Deadline":
        """Return the deadline `timeout_s` from now."""
        return cls(clock, clock.now_ns() + to_ns(timeout_s))

    def left_s(self) -> float:
        """Return the time left on this computer's clock, s; zero when the deadline has passed."""
        return max(0.0, host_s(self.clock, (self.time_ns - self.clock.now_ns()) / NS_PER_S))


def probe_controller(host: str, timeout_s: float, clock: Clock | None = None) -> Version:
    """Read the controller's version, and check that its time advances and that it accepts scripts.

    Returns major, minor, bugfix and build. Raises `DeviceTimeoutError` if the controller sends nothing within
    `timeout_s`, `DeviceError` if it cannot be reached, is not an e-Series controller, is too old, or sends
    invalid data.
    """
    deadline = Deadline.after(timeout_s, clock or SystemClock())
    with connect(host, RTDE_PORT, deadline) as connection:
        _agree_on_protocol(connection, deadline)
        version = parse_version(_ask(connection, _CONTROLLER, b"", deadline))
        _check_time_advances(connection, deadline)
    if version[0] != SERIES:
        raise DeviceError(
            f"arm: {host} runs software {version[0]}.{version[1]}; this driver is for e-Series ({SERIES}.x)"
        )
    if version[:2] < LEAST:
        raise DeviceError(
            f"arm: {host} runs PolyScope {version[0]}.{version[1]}, which is too old for ur-rtde: update the "
            f"controller to {LEAST[0]}.{LEAST[1]} or later"
        )
    connect(host, SCRIPT_PORT, deadline).close()
    return version


def read_speed_fraction(host: str, timeout_s: float, clock: Clock | None = None) -> float:
    """Return the position of the pendant's speed slider, 0 to 1. Only reads.

    Raises the same errors as `probe_controller`.
    """
    deadline = Deadline.after(timeout_s, clock or SystemClock())
    with connect(host, RTDE_PORT, deadline) as connection:
        _agree_on_protocol(connection, deadline)
        _stream(connection, "target_speed_fraction", deadline)
        (fraction,) = struct.unpack(">d", _newest(connection, deadline))
    require_fraction("the arm's speed_fraction", fraction)
    return float(fraction)


def _agree_on_protocol(connection: socket.socket, deadline: Deadline) -> None:
    accepted = _ask(connection, _VERSION, struct.pack(">H", PROTOCOL_VERSION), deadline)
    if accepted != b"\x01":
        raise DeviceError(
            f"arm: its controller refuses version {PROTOCOL_VERSION} of the real-time data exchange; "
            "update the controller's software"
        )


def _stream(connection: socket.socket, variable: str, deadline: Deadline) -> None:
    """Make the controller send a floating-point variable periodically."""
    kinds = _ask(connection, _OUTPUTS, struct.pack(">d", _TRIAL_HZ) + variable.encode(), deadline)
    if kinds[1:] != b"DOUBLE":
        raise DeviceError(
            f"arm: the controller refuses to send its {variable} ({kinds[1:].decode(errors='replace')}); "
            "make sure that no other client or fieldbus uses it, then restart it"
        )
    if _ask(connection, _START, b"", deadline) != b"\x01":
        raise DeviceError("arm: the controller refuses to start sending its state; restart it")


def _check_time_advances(connection: socket.socket, deadline: Deadline) -> None:
    """Read time stamps until they advance: a frozen controller keeps sending the old one."""
    _stream(connection, "timestamp", deadline)
    first = _newest(connection, deadline)
    while _newest(connection, deadline) == first:
        if not deadline.left_s():
            raise DeviceTimeoutError(
                "arm: the controller's time stands still, so its state is unknown; restart it"
            )


def _newest(connection: socket.socket, deadline: Deadline) -> bytes:
    kind, payload = b"", b""
    while kind != _DATA:
        kind, payload = read_package(lambda most: receive(connection, most, deadline, "state"))
    return payload[1:]


def parse_version(payload: bytes) -> Version:
    """Decode the controller's version. Raises `DeviceError`."""
    if len(payload) != 16:
        raise DeviceError(
            f"arm: the controller's version has {len(payload)} bytes instead of 16; is this a UR controller?"
        )
    major, minor, bugfix, build = struct.unpack(">4I", payload)
    return major, minor, bugfix, build


def connect(host: str, port: int, deadline: Deadline) -> socket.socket:
    """Open a connection. Raises `DeviceError` with what to check."""
    try:
        connection = socket.create_connection((host, port), timeout=max(deadline.left_s(), 1e-3))
    except TimeoutError as error:
        raise DeviceTimeoutError(
            f"arm: no answer from {host} port {port}; check its address, power and network cable"
        ) from error
    except (OSError, UnicodeError) as error:
        raise DeviceError(
            f"arm: cannot reach {host} port {port} ({error}); check its address, power and network cable"
        ) from error
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def send(connection: socket.socket, data: bytes, deadline: Deadline, what: str) -> None:
    try:
        connection.settimeout(max(deadline.left_s(), 1e-3))
        connection.sendall(data)
    except OSError as error:
        raise DeviceError(f"arm: the connection broke at {what} ({error}); check the network") from error


def receive(connection: socket.socket, most: int, deadline: Deadline, what: str) -> bytes:
    """Wait for up to `most` bytes, at least one. Raises `DeviceError` or `DeviceTimeoutError`."""
    connection.settimeout(max(deadline.left_s(), 1e-3))
    try:
        data = connection.recv(most)
    except TimeoutError as error:
        raise DeviceTimeoutError(
            f"arm: the controller takes connections but does not answer ({what}); restart it"
        ) from error
    except OSError as error:
        raise DeviceError(f"arm: the connection broke at {what} ({error}); check the network") from error
    if not data:
        raise DeviceError(f"arm: the controller closed the connection at {what}; is it starting up?")
    return data


def read_package(read: Callable[[int], bytes]) -> tuple[bytes, bytes]:
    """Read one package of the real-time data exchange; return its type and its payload.

    read: returns at least one and at most the given number of bytes. Raises `DeviceError` for an impossible
    package size.
    """
    size, kind = _HEADER.unpack(_exactly(read, _HEADER.size))
    if not _HEADER.size <= size <= _LONGEST:
        raise DeviceError(f"arm: a package of {size} bytes came at the start; is this a UR controller?")
    return bytes([kind]), _exactly(read, size - _HEADER.size)


def _exactly(read: Callable[[int], bytes], count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += read(count - len(data))
    return data


def _ask(connection: socket.socket, kind: bytes, payload: bytes, deadline: Deadline) -> bytes:
    """Send a package and return the payload of its answer; text messages in between are skipped."""
    what = f"request '{kind.decode()}' on port {RTDE_PORT}"
    send(connection, _HEADER.pack(_HEADER.size + len(payload), kind[0]) + payload, deadline, what)
    while deadline.left_s():
        answered, answer = read_package(lambda most: receive(connection, most, deadline, what))
        if answered == kind:
            return answer
        if answered != _TEXT:
            raise DeviceError(f"arm: {what} was answered with {answered!r}; is this a UR controller?")
    raise DeviceTimeoutError(f"arm: the controller does not answer {what} in time; restart it")


DASHBOARD_PORT = 29999
"""TCP port of the controller's dashboard server (dashboard manual)."""
TIMEOUT_S = 0.5
"""Time limit of a request."""
_LONGEST_LINE = 4096
"""Size limit of an answer, bytes."""
RELEASED = "Protective stop releasing"


class Dashboard:
    """A connection to the dashboard. Any thread may use it."""

    def __init__(self, host: str, timeout_s: float = TIMEOUT_S, clock: Clock | None = None) -> None:
        """Connect and read the greeting. Raises `DeviceError` or `DeviceTimeoutError`."""
        self._host, self._timeout_s = host, timeout_s
        self._clock: Clock = clock or SystemClock()
        self._lock = threading.Lock()
        self._closed = False
        self._connect()

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        self._closed = True
        self._connection.close()

    def ask(self, request: str) -> str:
        """Send one line and return the answer. Raises `DeviceError` or `DeviceTimeoutError`.

        A broken connection is opened once more, because the controller drops it now and then, and a stop
        must not fail for that reason.
        """
        with self._lock:
            try:
                return self._ask(request)
            except DeviceTimeoutError:
                self._connection.close()  # a late answer must not be read as that of the next request
                raise
            except DeviceError:
                self._connection.close()
                if self._closed:
                    raise
                self._connect()
                return self._ask(request)

    def _connect(self) -> None:
        deadline = Deadline.after(self._timeout_s, self._clock)
        self._rest = b""
        self._connection = connect(self._host, DASHBOARD_PORT, deadline)
        try:
            self._line(deadline, "greeting")
        except DeviceError:
            self._connection.close()
            raise

    def _ask(self, request: str) -> str:
        data, what = request.encode() + b"\n", f"'{request}'"
        send(self._connection, data, Deadline.after(self._timeout_s, self._clock), f"dashboard, {what}")
        return self._line(Deadline.after(self._timeout_s, self._clock), what)

    def _line(self, deadline: Deadline, what: str) -> str:
        while b"\n" not in self._rest:
            if len(self._rest) > _LONGEST_LINE:
                raise DeviceError(
                    f"arm: the dashboard's answer to {what} has no end; is this a UR controller?"
                )
            self._rest += receive(self._connection, _LONGEST_LINE, deadline, f"dashboard, {what}")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode(errors="replace").strip()
