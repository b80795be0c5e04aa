"""MJPEG from various servers: read, timed, reopened."""

import socket
import threading
import time

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import NotConnectedError
from drivers.types import Frame
from drivers.video.external_camera import ExternalCamera
from support.connected import connected
from support.mjpeg_servers import JPEGS, SERVERS, SIZE, Behaviour, plain, silent_after, stamped
from support.waiting import LIMIT_S


def read(serve, behaviour: Behaviour, count: int, size=None) -> tuple[ExternalCamera, list[Frame]]:
    """Frames of a server, and the camera that read them, which is disconnected."""
    with connected(ExternalCamera("C1", serve(behaviour).url, 30.0, size)) as camera:
        frames = [camera.next_frame(2.0) for _ in range(count)]
    return camera, frames


@pytest.mark.parametrize("kind", SERVERS)
def test_streams_of_other_servers_are_read_byte_for_byte(serve, kind: str) -> None:
    camera, frames = read(serve, SERVERS[kind], 20, SIZE)
    assert [frame.jpeg for frame in frames] == JPEGS[:20]
    assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 20))
    assert camera.time_kind == "arrival"


def test_stopped_server_is_reopened_and_the_gap_is_counted(serve) -> None:
    camera, frames = read(serve, lambda c, _: plain(c), len(JPEGS) + 5, SIZE)
    steps = np.diff([frame.sequence for frame in frames])
    assert steps[len(JPEGS) - 1] > 1
    assert camera.counters()["reopened"] == 1
    assert camera.counters()["dropped"] == steps[len(JPEGS) - 1] - 1


def test_server_times_of_this_computers_clock_are_used(serve) -> None:
    with connected(ExternalCamera("C1", serve(stamped(0.0, list(range(30)))).url, 30.0)) as camera:
        times_ns = [(camera.next_frame(1.0).time_ns, SystemClock().now_ns()) for _ in range(20)]
    assert camera.time_kind == "peer"
    assert min(now - time_ns for time_ns, now in times_ns) >= 20_000_000


@pytest.mark.parametrize("offset_s", [1.7e9, -500.0, 10.0])
def test_server_times_of_another_clock_are_ignored(serve, offset_s: float) -> None:
    camera, (frame,) = read(serve, stamped(offset_s, list(range(30))), 1)
    assert camera.time_kind == "arrival"
    assert abs(SystemClock().now_ns() - frame.time_ns) < 1e9


def test_missing_frames_are_detected_from_server_numbers(serve) -> None:
    camera, frames = read(serve, stamped(0.0, [5, 6, 9, 10, 11, 20]), 6)
    assert [frame.sequence for frame in frames] == [5, 6, 9, 10, 11, 20]
    assert camera.counters()["dropped"] == 2 + 8


def test_disconnecting_wakes_a_waiting_reader(serve) -> None:
    camera = ExternalCamera("C1", serve(silent_after(1, 1.0)).url, 30.0)
    camera.connect()
    camera.next_frame(1.0)
    threading.Timer(0.1, camera.disconnect).start()
    began = time.monotonic()
    with pytest.raises(NotConnectedError, match="disconnected"):
        camera.next_frame(2 * LIMIT_S)
    assert time.monotonic() - began < LIMIT_S


def test_a_name_and_password_in_the_address_are_sent(serve) -> None:
    seen: list[bytes] = []

    def behave(connection: socket.socket, request: bytes) -> None:
        seen.append(request)
        plain(connection)

    camera = ExternalCamera("C1", serve(behave).url.replace("//", "//user:p%40ss@"), 30.0)
    camera.connect()
    camera.disconnect()
    assert b"Authorization: Basic dXNlcjpwQHNz" in seen[0]
