"""Client of the dashboard server of the arm's controller: one line per request and answer, port 29999.

ur-rtde's own client waits up to 2.5 s for a line, which is too long for a stop. Wording of requests and
replies: Universal Robots, "Dashboard Server e-Series".
"""

import re
import threading
from types import TracebackType

from drivers.clock import Clock, SystemClock, host_s
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.ur5e.probe import Deadline, connect, receive

PORT = 29999
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

    def __enter__(self) -> "Dashboard":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
        self._connection = connect(self._host, PORT, deadline)
        try:
            self._line(deadline, "greeting")
        except DeviceError:
            self._connection.close()
            raise

    def _ask(self, request: str) -> str:
        try:
            self._connection.settimeout(host_s(self._clock, self._timeout_s))
            self._connection.sendall(request.encode() + b"\n")
        except OSError as error:
            raise DeviceError(
                f"arm: the dashboard connection broke at '{request}' ({error}); check the network"
            ) from error
        return self._line(Deadline.after(self._timeout_s, self._clock), f"'{request}'")

    def _line(self, deadline: Deadline, what: str) -> str:
        while b"\n" not in self._rest:
            if len(self._rest) > _LONGEST_LINE:
                raise DeviceError(
                    f"arm: the dashboard's answer to {what} has no end; is this a UR controller?"
                )
            self._rest += receive(self._connection, _LONGEST_LINE, deadline, f"dashboard, {what}")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode(errors="replace").strip()


def serial_number(reply: str) -> str:
    """Return the serial number in a reply; empty if the reply contains none."""
    return reply if re.fullmatch(r"\d+", reply) else ""


def refuse_local_control(reply: str) -> None:
    """Raise `DeviceError` unless the reply to "is in remote control" is true."""
    if "true" not in reply.lower():
        raise DeviceError(
            f"arm: remote control is off (the dashboard answers '{reply}'); "
            "switch the pendant to Remote Control, top right, then connect again"
        )
