"""The driver's first exchange with a controller, and with silent, wrong, broken or slow peers."""

import itertools
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.ur5e.controller import Dashboard, probe_controller
from support.slow_motion import CLOCK, SLOWNESS

RTDE, SCRIPT, DASHBOARD = 30004, 30003, 29999
LIMIT_S = 0.4
Serve = Callable[[socket.socket], None]
_addresses = itertools.count(1)


class Peer:
    """A server on a controller's ports, at a separate address."""

    def __init__(self) -> None:
        pid = os.getpid()
        self.host = f"127.{100 + pid % 100}.{pid // 100 % 250}.{next(_addresses)}"
        self._opened: list[socket.socket] = []
        self._threads: list[threading.Thread] = []

    def listen(self, port: int, serve: Serve) -> None:
        listener = socket.create_server((self.host, port))
        self._opened.append(listener)
        self._threads.append(threading.Thread(target=self._accept, args=(listener, serve), daemon=True))
        self._threads[-1].start()

    def close(self) -> None:
        for opened in self._opened:
            with suppress(OSError):
                opened.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(5.0)
        for opened in self._opened:
            opened.close()

    def _accept(self, listener: socket.socket, serve: Serve) -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                self._opened.append(connection)
                serve(connection)


def controller(
    version: tuple[int, ...] = (5, 11, 0, 1), stamps: Iterator[float] | None = None, cut: int = 4096
) -> Serve:
    """A peer that answers like a controller, in pieces of `cut` bytes."""
    times = stamps or itertools.count(1.0, 0.008)
    answers = {b"V": b"\x01", b"v": struct.pack(">4I", *version), b"O": b"\x01DOUBLE", b"S": b"\x01"}

    def send(connection: socket.socket, kind: bytes, payload: bytes) -> None:
        whole = struct.pack(">Hc", 3 + len(payload), kind) + payload
        for start in range(0, len(whole), cut):
            connection.sendall(whole[start : start + cut])

    def serve(connection: socket.socket) -> None:
        with suppress(OSError):
            while header := connection.recv(3):
                size, kind = struct.unpack(">Hc", header)
                if size > 3:
                    connection.recv(size - 3)
                send(connection, b"M", b"hello")
                send(connection, kind, answers[kind])
                for _ in range(20 if kind == b"S" else 0):
                    send(connection, b"U", b"\x01" + struct.pack(">d", next(times)))

    return serve


def silent(connection: socket.socket) -> None:
    """Accept a connection and send nothing."""


def talks(data: bytes, pause_s: float = 0.0) -> Serve:
    def serve(connection: socket.socket) -> None:
        for start in range(0, len(data), 1 if pause_s else 4096):
            connection.sendall(data[start : start + 1] if pause_s else data[start : start + 4096])
            time.sleep(pause_s)
        connection.shutdown(socket.SHUT_WR)

    return serve


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


@pytest.mark.parametrize("cut", [1, 4096])
def test_probe_of_a_controller_returns_its_version(peer: Peer, cut: int) -> None:
    peer.listen(RTDE, controller(cut=cut))
    peer.listen(SCRIPT, silent)
    assert probe_controller(peer.host, 2.0, CLOCK) == (5, 11, 0, 1)


def test_unreachable_controller_and_closed_script_port_are_reported(peer: Peer) -> None:
    with pytest.raises(DeviceError, match=r"cannot reach.*cable"):
        probe_controller(peer.host, LIMIT_S, CLOCK)
    peer.listen(RTDE, controller())
    with pytest.raises(DeviceError, match="30003"):
        probe_controller(peer.host, LIMIT_S, CLOCK)


@pytest.mark.parametrize(
    ("serve", "error", "said"),
    [
        (silent, DeviceTimeoutError, "does not answer"),
        (talks(b""), DeviceError, "closed the connection"),
        (talks(b"\x00\x04V"), DeviceError, "closed the connection"),
        (talks(b"HTTP/1.1 400 Bad Request\r\n"), DeviceError, "is this a UR controller"),
        (talks(b"\x00\x02V"), DeviceError, "package of 2 bytes"),
        (talks(b"\x00\x04V\x00"), DeviceError, "refuses version 2"),
        (talks(b"\x00\x04V\x01\x00\x05v\x01\x02"), DeviceError, "2 bytes instead of 16"),
        (talks(b"\x00\x04v\x01"), DeviceError, "answered with b'v'"),
        (talks(b"\x00\x04V\x01" * 3, pause_s=0.1 * SLOWNESS), DeviceTimeoutError, "does not answer"),
        (controller(version=(3, 15, 0, 0)), DeviceError, "software 3.15"),
        (controller(version=(10, 10, 0, 0)), DeviceError, "software 10.10"),
        (controller(version=(5, 3, 1, 0)), DeviceError, "PolyScope 5.3, which is too old.*5.4 or later"),
        (controller(stamps=itertools.repeat(4.0)), DeviceTimeoutError, "time stands still|does not answer"),
    ],
)
def test_faulty_peer_is_named_within_the_deadline(
    peer: Peer, serve: Serve, error: type[DeviceError], said: str
) -> None:
    peer.listen(RTDE, serve)
    peer.listen(SCRIPT, silent)
    began_ns = CLOCK.now_ns()
    with pytest.raises(error, match=said):
        probe_controller(peer.host, LIMIT_S, CLOCK)
    assert CLOCK.now_ns() - began_ns < to_ns(10 * LIMIT_S), (
        "the deadline is for the whole greeting, not for a byte"
    )


def test_dashboard_replies_line_by_line(peer: Peer) -> None:
    peer.listen(DASHBOARD, talks(b"Connected\ntrue\r\n20265500001\nnever asked"))
    with closing(Dashboard(peer.host, clock=CLOCK)) as dashboard:
        assert dashboard.ask("is in remote control") == "true"
        assert dashboard.ask("get serial number") == "20265500001"
    dashboard.close()
    with pytest.raises(DeviceError, match="dashboard"):
        dashboard.ask("stop")


@pytest.mark.parametrize(
    ("serve", "said"), [(silent, "greeting"), (talks(b"x" * 20_000), "no end"), (talks(b""), "closed")]
)
def test_peer_other_than_a_dashboard_is_rejected(peer: Peer, serve: Serve, said: str) -> None:
    peer.listen(DASHBOARD, serve)
    with pytest.raises(DeviceError, match=said):
        Dashboard(peer.host, LIMIT_S, CLOCK)


def test_broken_dashboard_connection_is_reopened_once(peer: Peer) -> None:
    peer.listen(DASHBOARD, talks(b"Connected\nStopped\n"))
    with closing(Dashboard(peer.host, clock=CLOCK)) as dashboard:
        assert [dashboard.ask("stop") for _ in range(3)] == ["Stopped"] * 3


def test_dashboard_without_an_answer_is_an_error_for_each_request(peer: Peer) -> None:
    peer.listen(DASHBOARD, talks(b"Connected\n"))
    with closing(Dashboard(peer.host, LIMIT_S, CLOCK)) as dashboard:
        for request in ("stop", "running"):
            with pytest.raises(DeviceError):
                dashboard.ask(request)
