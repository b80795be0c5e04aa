"""MJPEG from various servers: read, timed, reopened; servers without a good stream are named and rejected."""

import contextlib
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError
from drivers.types import Frame
from drivers.video.external_camera import ExternalCamera
from drivers.video.mjpeg import MjpegStream, send_settings, split_url
from support.connected import connected
from support.waiting import LIMIT_S

SIZE = (64, 48)
Behaviour = Callable[[socket.socket, bytes], None]


def jpeg_of(number: int) -> bytes:
    noise = np.random.default_rng(number).integers(0, 90, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    return cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


JPEGS = [jpeg_of(number) for number in range(40)]


class RawServer:
    """A TCP server that reads the head of a request and then runs a handler, in a thread per connection."""

    def __init__(self, behaviour: Behaviour) -> None:
        self._behaviour = behaviour
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._threads: list[threading.Thread] = []
        self._accepting = threading.Thread(target=self._accept)
        self._accepting.start()
        self.connections = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listening.getsockname()[1]}/video"

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for thread in (self._accepting, *self._threads):
            thread.join(5.0)
            assert not thread.is_alive()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            self.connections += 1
            self._threads.append(threading.Thread(target=self._serve, args=(connection,)))
            self._threads[-1].start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            connection.settimeout(3.0)
            request = b""
            while b"\r\n\r\n" not in request:
                request += connection.recv(4096)
            self._behaviour(connection, request)


HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=%s\r\n%s\r\n"


def chunked(data: bytes) -> bytes:
    return f"{len(data):x}\r\n".encode() + data + b"\r\n"


def plain(
    connection: socket.socket, boundary: bytes = b"b1", quoted: bool = False, length: bool = True
) -> None:
    announced = b'"' + boundary + b'"' if quoted else boundary
    connection.sendall(HEAD % (announced, b""))
    for jpeg in JPEGS:
        size = b"Content-Length: %d\r\n" % len(jpeg) if length else b""
        connection.sendall(b"--" + boundary + b"\r\n" + size + b"\r\n" + jpeg + b"\r\n")
        time.sleep(0.01)


def in_chunks(connection: socket.socket, request: bytes) -> None:
    connection.sendall(HEAD % (b"b1", b"Transfer-Encoding: chunked\r\n"))
    rng = random.Random(3)
    data = b"".join(b"--b1\r\n\r\n" + jpeg + b"\r\n" for jpeg in JPEGS)
    while data:
        size = rng.randrange(1, 3000)
        connection.sendall(chunked(data[:size]))
        data = data[size:]
        time.sleep(0.001)


def old_protocol(connection: socket.socket, request: bytes) -> None:
    connection.sendall(b"HTTP/1.0 200 OK\nContent-type: multipart/x-mixed-replace;boundary=--old\n\n")
    for jpeg in JPEGS:
        connection.sendall(b"--old\nContent-type: image/jpeg\n\n" + jpeg + b"\n")
        time.sleep(0.01)


def announces(boundary: bytes, less: int) -> Behaviour:
    """Send parts with the boundary b1, and a length that is too small by some bytes."""

    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (boundary, b""))
        for jpeg in JPEGS:
            head = b"--b1\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % (len(jpeg) - less)
            connection.sendall(head + jpeg + b"\r\n")
            time.sleep(0.01)

    return behave


SERVERS: dict[str, Behaviour] = {
    "with length": lambda c, _: plain(c),
    "other boundary": lambda c, _: plain(c, b"----=_Part_7:x"),
    "quoted boundary": lambda c, _: plain(c, b"two words", quoted=True),
    "no length": lambda c, _: plain(c, length=False),
    "chunked": in_chunks,
    "HTTP/1.0, bare line feeds": old_protocol,
    "boundary that is not sent": announces(b"another", 0),
    "length 2 too small": announces(b"b1", 2),
}


def stamped(offset_s: float, numbers: list[int]) -> Behaviour:
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (b"b", b""))
        for number in numbers:
            stamp = time.monotonic() - 0.02 + offset_s
            head = f"--b\r\nX-Timestamp: {stamp:.6f}\r\nX-Sequence: {number}\r\n\r\n".encode()
            connection.sendall(head + JPEGS[number % 40] + b"\r\n")
            time.sleep(0.01)

    return behave


def answer(text: bytes) -> Behaviour:
    return lambda connection, _: connection.sendall(text)


def silent_after(jpegs: int, seconds: float) -> Behaviour:
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (b"b", b""))
        for jpeg in JPEGS[:jpegs]:
            connection.sendall(b"--b\r\n\r\n" + jpeg + b"\r\n")
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:  # a drip of bytes keeps the socket alive but is no image
            connection.sendall(b"--b\r\nX: " if jpegs == 0 else b"\r\n")
            time.sleep(0.05)

    return behave


Serve = Callable[[Behaviour], RawServer]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Start servers with given handlers; they are stopped after the test."""
    started: list[RawServer] = []

    def start(behaviour: Behaviour) -> RawServer:
        started.append(RawServer(behaviour))
        return started[-1]

    yield start
    for server in started:
        server.close()


def read(serve, behaviour: Behaviour, count: int, size=None) -> tuple[ExternalCamera, list[Frame]]:
    """Frames of a server, and the camera that read them, which is disconnected."""
    with connected(ExternalCamera("C1", serve(behaviour).url, 30.0, size)) as camera:
        frames = [camera.next_frame(2.0) for _ in range(count)]
    return camera, frames


@pytest.mark.parametrize("kind", SERVERS)
def test_streams_of_other_servers_are_read_byte_for_byte(serve: Serve, kind: str) -> None:
    camera, frames = read(serve, SERVERS[kind], 20, SIZE)
    assert [frame.jpeg for frame in frames] == JPEGS[:20]
    assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 20))
    assert camera.time_kind == "arrival"


def test_stopped_server_is_reopened_and_the_gap_is_counted(serve: Serve) -> None:
    camera, frames = read(serve, lambda c, _: plain(c), len(JPEGS) + 5, SIZE)
    steps = np.diff([frame.sequence for frame in frames])
    assert steps[len(JPEGS) - 1] > 1
    assert camera.counters()["reopened"] == 1
    assert camera.counters()["dropped"] == steps[len(JPEGS) - 1] - 1


def test_server_times_of_this_computers_clock_are_used(serve: Serve) -> None:
    with connected(ExternalCamera("C1", serve(stamped(0.0, list(range(30)))).url, 30.0)) as camera:
        times_ns = [(camera.next_frame(1.0).time_ns, SystemClock().now_ns()) for _ in range(20)]
    assert camera.time_kind == "peer"
    assert min(now - time_ns for time_ns, now in times_ns) >= 20_000_000


@pytest.mark.parametrize("offset_s", [1.7e9, -500.0, 10.0])
def test_server_times_of_another_clock_are_ignored_and_missing_numbers_counted(
    serve: Serve, offset_s: float
) -> None:
    camera, frames = read(serve, stamped(offset_s, [5, 6, 9, 10, 11, 20]), 6)
    assert camera.time_kind == "arrival"
    assert abs(SystemClock().now_ns() - frames[-1].time_ns) < 1e9
    assert [frame.sequence for frame in frames] == [5, 6, 9, 10, 11, 20]
    assert camera.counters()["dropped"] == 2 + 8


def test_disconnecting_wakes_a_waiting_reader(serve: Serve) -> None:
    camera = ExternalCamera("C1", serve(silent_after(1, 1.0)).url, 30.0)
    camera.connect()
    camera.next_frame(1.0)
    threading.Timer(0.1, camera.disconnect).start()
    began = time.monotonic()
    with pytest.raises(NotConnectedError, match="disconnected"):
        camera.next_frame(2 * LIMIT_S)
    assert time.monotonic() - began < LIMIT_S


def test_a_name_and_password_in_the_address_are_sent(serve: Serve) -> None:
    seen: list[bytes] = []
    url = serve(lambda connection, request: (seen.append(request), plain(connection))[1]).url
    with connected(ExternalCamera("C1", url.replace("//", "//user:p%40ss@"), 30.0)):
        assert b"Authorization: Basic dXNlcjpwQHNz" in seen[0]


def test_images_of_another_size_are_refused_and_named(serve: Serve) -> None:
    camera = ExternalCamera("C1", serve(lambda c, _: plain(c)).url, 30.0, (640, 480))
    with pytest.raises(DeviceError, match=r"C1: its images are 64 x 48 px, expected 640 x 480"):
        camera.connect()


@pytest.mark.parametrize(
    ("behaviour", "said"),
    [
        (answer(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"), "404 Not Found; check the address"),
        (answer(b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\n\r\n"), "asks for a name and password"),
        (
            answer(b"HTTP/1.1 302 Found\r\nLocation: /new?x=1\r\n\r\n"),
            r"give the address http://127.*/new\?x=1",
        ),
        (answer(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<p>"), "sends 'text/html'"),
        (answer(b"\x00\xff nonsense\r\n\r\n"), "check the server"),
        (answer(b""), "check the server"),
        (answer(HEAD % (b"b", b"")), "closed the connection"),
        (answer(HEAD % (b"b", b"Transfer-Encoding: chunked\r\n") + b"zz\r\n"), "check the server"),
        (silent_after(0, 2.5), "no image within"),
    ],
)
def test_server_without_a_stream_is_refused_and_named(serve: Serve, behaviour: Behaviour, said: str) -> None:
    camera = ExternalCamera("C1", serve(behaviour).url, 30.0)
    with pytest.raises(DeviceError, match=said):
        camera.connect()
    with pytest.raises(NotConnectedError, match="connect"):
        camera.next_frame(0.1)


def test_silent_server_times_out_and_is_reopened(serve: Serve) -> None:
    left = [3]
    server = serve(lambda c, r: silent_after(left.pop() if left else 0, 2.5)(c, r))
    with connected(ExternalCamera("C1", server.url, 30.0)) as camera:
        for _ in range(3):
            camera.next_frame(1.0)
        with pytest.raises(DeviceTimeoutError, match="still streams"):
            camera.next_frame(0.3)
        with pytest.raises(DeviceTimeoutError, match=r"no image within 1.5 s.*opening it again"):
            camera.next_frame(1.8)
        began = time.monotonic()
    assert time.monotonic() - began < LIMIT_S
    assert server.connections >= 2


@pytest.mark.fuzz
def test_random_replies_give_typed_errors(serve: Serve, cases: Callable[[int], int]) -> None:
    rng = random.Random(4)

    def behave(connection: socket.socket, request: bytes) -> None:
        good = HEAD % (b"b", rng.choice((b"", b"Transfer-Encoding: chunked\r\n", b"Content-Length: 90\r\n")))
        answer = bytearray(good + b"--b\r\n\r\n" + JPEGS[0][:100] + rng.randbytes(rng.randrange(200)))
        for _ in range(rng.randrange(8)):
            answer[rng.randrange(len(answer))] = rng.randrange(256)
        connection.sendall(answer[: rng.randrange(len(answer))])

    url = serve(behave).url
    for _ in range(cases(300)):
        stream = None
        try:
            stream = MjpegStream(url, 30.0, SystemClock())
            for _ in range(3):
                stream.read()
        except DeviceError as error:
            assert url in str(error) or "MJPEG" in str(error)  # noqa: PT017 - parts may come, then this
        finally:
            if stream is not None:
                stream.close()


@pytest.mark.parametrize(
    "url", ["ftp://me:s3cret@h/x", "http://", "http://host:99999/", "http://host:0/", "rtsp://h/"]
)
def test_invalid_addresses_are_rejected_without_their_password(url: str) -> None:
    with pytest.raises(InputError, match="not an address") as raised:
        split_url(url)
    assert "s3cret" not in str(raised.value)


def test_refused_settings_are_reported_with_address_and_values(serve: Serve) -> None:
    url = serve(answer(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")).url
    with pytest.raises(DeviceError, match=r"settings \{'rate_hz': 7\} failed: .* 400"):
        send_settings(url, {"rate_hz": 7})


def test_error_messages_contain_no_password() -> None:
    for address in ("http://me:s3cret@127.0.0.1:9/", "http://127.0.0.1:9/?pwd=s3cret"):
        for call in (lambda url: MjpegStream(url, 60.0, SystemClock()), lambda url: send_settings(url, {})):
            with pytest.raises(DeviceError, match=r"127\.0\.0\.1:9.*the connection was refused") as raised:
                call(address)
            assert "s3cret" not in str(raised.value)
