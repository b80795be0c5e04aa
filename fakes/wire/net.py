"""Threads and servers of the fakes, their loopback addresses, and the side channel of running fakes.

The side channel takes one JSON object per line and gives one answer per line. It is for the actions of a
person at the bench (placing an object), for faults, and for the ground truth (the tool's true position), none
of which go through a device's protocol.
"""

import json
import logging
import os
import socket
import socketserver
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from drivers.errors import DeviceError, InputError, RigError

CONTROLLER_PORTS = (29999, 30001, 30002, 30003, 30004)
ADDRESSES = tuple(f"127.0.0.{number}" for number in range(1, 33))
Command = Callable[..., Mapping[str, Any] | None]
TIMEOUT_S = JOIN_S = 5.0
LONGEST_LINE = 65536
_log = logging.getLogger(__name__)


class Part:
    """A part of the fakes that a thread runs from `start` to `stop`.

    work: runs in the thread until `stopping` is set. failure: the error that ended it, None without one. The
    owner of the fakes polls it and then ends the process: fakes without one of their threads would only
    appear to work.
    """

    def __init__(self, name: str, work: Callable[[], None]) -> None:
        self.failure: Exception | None = None
        self.stopping = threading.Event()
        self._work, self._name = work, name
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread. Safe before `start`, and to call twice."""
        self.stopping.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def _run(self) -> None:
        try:
            self._work()
        except Exception as error:
            _log.exception("%s has ended", self._name)
            self.failure = error


class BackgroundServer(Part):
    """Serves in a thread. poll_s: how often it checks whether it has to stop."""

    def __init__(self, server: socketserver.TCPServer, poll_s: float = 0.1) -> None:
        super().__init__(type(self).__name__, lambda: server.serve_forever(poll_s))
        self._server = server

    @property
    def host_port(self) -> tuple[str, int]:
        host, port = self._server.server_address[:2]
        return str(host), int(port)

    def stop(self) -> None:
        if self._thread.is_alive():
            self._server.shutdown()
        super().stop()
        self._server.server_close()


class QuietServer(socketserver.ThreadingMixIn):
    """A server with a thread per connection, which ignores clients that have disconnected."""

    daemon_threads = True
    request_queue_size = 128

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Do nothing."""


def free_address() -> str:
    """Return an address whose controller ports are free. Raises `InputError` if there is none.

    Each process starts the search at another address, so that two processes at a time do not take the same.
    """
    first = os.getpid() % len(ADDRESSES)
    for address in (*ADDRESSES[first:], *ADDRESSES[:first]):
        if not taken_ports(address):
            return address
    raise InputError(
        f"no free loopback address from {ADDRESSES[0]} to {ADDRESSES[-1]}: end other fakes first"
    )


def require_free(address: str) -> None:
    """Raise `InputError` unless a controller can be served there, for this computer alone."""
    if not address.startswith("127."):
        raise InputError(
            f"{address} is no loopback address: fakes are for this computer alone, use 127.0.0.1"
        )
    if taken := taken_ports(address):
        ports = ", ".join(map(str, taken))
        raise InputError(
            f"{address}: port {ports} cannot be served (in use?); give another, as --host 127.0.0.2"
        )


def taken_ports(address: str) -> list[int]:
    """Return the controller ports that are in use, or that cannot be served at all."""
    taken = []
    with ExitStack() as stack:
        for port in CONTROLLER_PORTS:
            try:
                stack.enter_context(socket.create_server((address, port)))
            except OSError:
                taken.append(port)
    return taken


class ControlServer(BackgroundServer):
    """The server of the side channel: commands by name, each in the thread of its connection."""

    def __init__(self, commands: Mapping[str, Command], host: str = "127.0.0.1") -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                while line := self.rfile.readline(LONGEST_LINE):
                    self.wfile.write(json.dumps(_answer(commands, line)).encode() + b"\n")

        super().__init__(_ControlServer((host, 0), Handler))

    @property
    def address(self) -> str:
        host, port = self.host_port
        return f"{host}:{port}"


class Control:
    """The client of the side channel: `Control("127.0.0.1:5555").call("place", object="t1")`."""

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


class _ControlServer(QuietServer, socketserver.TCPServer):
    allow_reuse_address = True


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
