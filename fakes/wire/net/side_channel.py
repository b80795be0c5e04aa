"""The side channel of running fakes: one JSON object per line, one answer per line.

It is for the actions of a person at the bench (placing an object), for faults, and for the ground truth (the
tool's true position), none of which go through a device's protocol.
"""

import json
import logging
import socket
import socketserver
from collections.abc import Callable, Mapping
from typing import Any

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError, RigError
from fakes.wire.net.background import BackgroundServer

Command = Callable[..., Mapping[str, Any] | None]
TIMEOUT_S = 5.0
LONGEST_LINE = 65536
_log = logging.getLogger(__name__)


class ControlServer(BackgroundServer):
    """Serves commands by name on a loopback port, each in its connection's thread."""

    def __init__(self, commands: Mapping[str, Command], host: str = "127.0.0.1", port: int = 0) -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                while line := self.rfile.readline(LONGEST_LINE):
                    self.wfile.write(json.dumps(_answer(commands, line)).encode() + b"\n")

        super().__init__(_Server((host, port), Handler))

    @property
    def address(self) -> str:
        """Where it listens, "host:port"."""
        host, port = self.host_port
        return f"{host}:{port}"


class Control:
    """The client: `Control("127.0.0.1:5555").call("place", object="t1")`."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        if not port.isdigit():
            raise InputError(f"'{address}' is no address of running fakes: it is host:port")
        self.address = address
        self._where = (host or "127.0.0.1", int(port))

    def call(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Send a command and return the answer.

        Raises `DeviceError` if there is no answer, `InputError` if the fakes refuse the command.
        """
        try:
            with socket.create_connection(self._where, timeout=TIMEOUT_S) as connection:
                connection.sendall(json.dumps({"do": command, **arguments}).encode() + b"\n")
                answer = json.loads(connection.makefile("rb").readline())
        except (OSError, ValueError) as error:
            raise DeviceError(
                f"fakes at {self.address}: no answer ({error}); start them with 'rig fakes serve'"
            ) from error
        if "error" in answer:
            raise InputError(f"fakes at {self.address}: {answer['error']}")
        return answer


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    request_queue_size = 128
    allow_reuse_address = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that have disconnected."""


def _answer(commands: Mapping[str, Command], line: bytes) -> dict[str, Any]:
    try:
        request = json.loads(line)
        command = commands[request.pop("do")]
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        known = ", ".join(commands)
        return {"error": f'expected one JSON object a line, as {{"do": "status"}}; commands are {known}'}
    try:
        return dict(command(**request) or {})
    except RigError as error:
        return {"error": str(error)}
    except TypeError as error:
        return {"error": f"wrong arguments: {error}"}
    except Exception as error:  # an unexpected error is answered; the fakes keep running
        _log.exception("side channel: %s", request)
        return {"error": f"failed: {type(error).__name__}: {error}"}


LONGEST_S = 86_400.0


def duration_ns(value: Any, whose: str) -> int | None:
    """Return a duration in s as ns, None for None. Raises `InputError` with `whose` in its text."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= LONGEST_S:
        raise InputError(f"{whose}: a duration of {value!r}: give 0 to {LONGEST_S:g} s")
    return to_ns(value)


def whole_number(value: Any, whose: str, most: int) -> int | None:
    """Return a whole number from 0 to `most`, None for None. Raises `InputError` with `whose` in its text."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise InputError(f"{whose}: {value!r}: give a whole number from 0 to {most}")
    return value
