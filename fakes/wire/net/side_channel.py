"""The side channel of running fakes: one JSON object a line, one answer a line.

What a person does at a bench (lay an object down), what goes wrong at one (faults), and what only
the simulation knows (where the tool truly is) goes this way, never through a device's protocol.
"""

import json
import logging
import socket
import socketserver
from collections.abc import Callable, Mapping
from typing import Any

from drivers.errors import DeviceError, InputError, RigError
from fakes.wire.net.background import BackgroundServer

Command = Callable[..., Mapping[str, Any] | None]
TIMEOUT_S = 5.0
LONGEST_LINE = 65536
_log = logging.getLogger(__name__)


class ControlServer(BackgroundServer):
    """Serves commands by name on a loopback port; each runs in its connection's thread."""

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
    """The other end: `Control("127.0.0.1:5555").call("place", object="t1")`."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        if not port.isdigit():
            raise InputError(f"'{address}' is no address of running fakes: it is host:port")
        self.address = address
        self._where = (host or "127.0.0.1", int(port))

    def call(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Do something and return what the fakes answer.

        Raises `DeviceError` when nobody answers, `InputError` when they refuse.
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
        """A client that went away is no event."""


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
    except Exception as error:  # what nobody thought of is said, and leaves the fakes as they are
        _log.exception("side channel: %s", request)
        return {"error": f"failed: {type(error).__name__}: {error}"}
