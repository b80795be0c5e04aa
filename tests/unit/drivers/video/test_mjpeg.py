"""MJPEG from servers of all kinds, over real sockets: read, timed, re-opened, refused by name."""

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
from drivers.video.external_camera import ExternalCamera
from drivers.video.mjpeg import MjpegStream, send_settings, split_url

SIZE = (64, 48)
Behaviour = Callable[[socket.socket, bytes], None]


def jpeg_of(number: int) -> bytes:
    noise = np.random.default_rng(number).integers(0, 90, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    return cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


JPEGS = [jpeg_of(number) for number in range(40)]


class RawServer:
    """A TCP server that reads a request's head and then does what it is told; a thread each."""

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


@pytest.fixture
def serve() -> Iterator[Callable[[Behaviour], RawServer]]:
    """Start servers by what they do; they are stopped afterwards."""
    started: list[RawServer] = []

    def start(behaviour: Behaviour) -> RawServer:
        started.append(RawServer(behaviour))
        return started[-1]

    yield start
    for server in started:
        server.close()


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


SERVERS: dict[str, Behaviour] = {
    "with length": lambda c, _: plain(c),
    "other boundary": lambda c, _: plain(c, b"----=_Part_7:x"),
    "quoted boundary": lambda c, _: plain(c, b"two words", quoted=True),
    "no length": lambda c, _: plain(c, length=False),
    "chunked": in_chunks,
    "HTTP/1.0, bare line feeds": old_protocol,
}


@pytest.mark.parametrize("kind", SERVERS)
def test_streams_of_other_servers_are_read_byte_for_byte(serve, kind: str) -> None:
    camera = ExternalCamera("C1", serve(SERVERS[kind]).url, 30.0, SIZE)
    camera.connect()
    frames = [camera.next_frame(1.0) for _ in range(20)]
    camera.disconnect()
    assert [frame.jpeg for frame in frames] == JPEGS[:20]
    assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 20))
    assert camera.time_kind == "arrival"


def test_a_server_that_stops_is_opened_again_and_the_gap_shows(serve) -> None:
    camera = ExternalCamera("C1", serve(lambda c, _: plain(c)).url, 30.0, SIZE)
    camera.connect()
    frames = [camera.next_frame(2.0) for _ in range(len(JPEGS) + 5)]
    camera.disconnect()
    steps = np.diff([frame.sequence for frame in frames])
    assert steps[len(JPEGS) - 1] > 1
    assert camera.counters()["reopened"] == 1
    assert camera.counters()["dropped"] == steps[len(JPEGS) - 1] - 1


def stamped(offset_s: float, numbers: list[int]) -> Behaviour:
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (b"b", b""))
        for number in numbers:
            stamp = time.monotonic() - 0.02 + offset_s
            head = f"--b\r\nX-Timestamp: {stamp:.6f}\r\nX-Sequence: {number}\r\n\r\n".encode()
            connection.sendall(head + JPEGS[number % 40] + b"\r\n")
            time.sleep(0.01)

    return behave


def test_times_of_our_own_clock_are_taken_from_the_server(serve) -> None:
    camera = ExternalCamera("C1", serve(stamped(0.0, list(range(30)))).url, 30.0)
    camera.connect()
    times_ns = [(camera.next_frame(1.0).time_ns, SystemClock().now_ns()) for _ in range(20)]
    camera.disconnect()
    assert camera.time_kind == "peer"
    assert min(now - time_ns for time_ns, now in times_ns) >= 20_000_000


@pytest.mark.parametrize("offset_s", [1.7e9, -500.0, 10.0])
def test_times_of_another_clock_are_not_taken(serve, offset_s: float) -> None:
    camera = ExternalCamera("C1", serve(stamped(offset_s, list(range(30)))).url, 30.0)
    camera.connect()
    frame = camera.newest_frame(1.0)
    camera.disconnect()
    assert camera.time_kind == "arrival"
    assert abs(SystemClock().now_ns() - frame.time_ns) < 1e9


def test_numbers_of_the_server_show_what_never_came(serve) -> None:
    camera = ExternalCamera("C1", serve(stamped(0.0, [5, 6, 9, 10, 11, 20])).url, 30.0)
    camera.connect()
    assert [camera.next_frame(1.0).sequence for _ in range(6)] == [5, 6, 9, 10, 11, 20]
    camera.disconnect()
    assert camera.counters()["dropped"] == 2 + 8


def test_damaged_images_are_withheld_counted_and_named(serve) -> None:
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (b"b", b""))
        connection.sendall(b"--b\r\n\r\n" + JPEGS[0] + b"\r\n")
        for _ in range(60):
            connection.sendall(b"--b\r\n\r\n" + JPEGS[1][:900] + b"\r\n")
            time.sleep(0.01)

    camera = ExternalCamera("C1", serve(behave).url, 30.0)
    camera.connect()
    assert camera.next_frame(1.0).jpeg == JPEGS[0]
    with pytest.raises(DeviceTimeoutError, match="its end is missing"):
        camera.next_frame(0.2)
    camera.disconnect()
    assert camera.counters()["damaged"] > 5


def test_images_of_another_size_are_refused_by_name(serve) -> None:
    camera = ExternalCamera("C1", serve(lambda c, _: plain(c)).url, 30.0, (640, 480))
    with pytest.raises(DeviceError, match=r"C1: its images are 64 x 48 px, 640 x 480 are asked for"):
        camera.connect()


def answer(text: bytes) -> Behaviour:
    return lambda connection, _: connection.sendall(text)


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (answer(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"), "404 Not Found; check the address"),
        (answer(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<p>"), "sends 'text/html'"),
        (answer(b"\x00\xff nonsense\r\n\r\n"), "check the server"),
        (answer(b""), "check the server"),
        (answer(HEAD % (b"b", b"")), "closed the connection"),
        (answer(HEAD % (b"b", b"Transfer-Encoding: chunked\r\n") + b"zz\r\n"), "check the server"),
    ],
)
def test_a_server_that_sends_no_stream_is_refused_by_name(serve, behaviour: Behaviour, message: str) -> None:
    camera = ExternalCamera("C1", serve(behaviour).url, 30.0)
    with pytest.raises(DeviceError, match=message):
        camera.connect()
    with pytest.raises(NotConnectedError, match="connect"):
        camera.next_frame(0.1)


def test_nobody_there_is_said_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="nobody listens there"):
        ExternalCamera("C1", f"http://127.0.0.1:{port}/video").connect()


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


def test_a_stuck_server_is_left_and_named_and_hangs_nobody(serve) -> None:
    left = [3]
    server = serve(lambda c, r: silent_after(left.pop() if left else 0, 2.5)(c, r))
    camera = ExternalCamera("C1", server.url, 30.0)
    camera.connect()
    for _ in range(3):
        camera.next_frame(1.0)
    with pytest.raises(DeviceTimeoutError, match="still streams"):
        camera.next_frame(0.3)
    with pytest.raises(DeviceTimeoutError, match=r"no image within 1.5 s.*opening it again"):
        camera.next_frame(1.8)
    began = time.monotonic()
    camera.disconnect()
    assert time.monotonic() - began < 1.0
    assert server.connections >= 2


def test_a_server_that_never_sends_an_image_is_given_up(serve) -> None:
    with pytest.raises(DeviceError, match="no image within"):
        ExternalCamera("C1", serve(silent_after(0, 2.5)).url, 30.0).connect()


def test_disconnecting_wakes_a_reader_that_waits(serve) -> None:
    camera = ExternalCamera("C1", serve(silent_after(1, 1.0)).url, 30.0)
    camera.connect()
    camera.next_frame(1.0)
    threading.Timer(0.1, camera.disconnect).start()
    began = time.monotonic()
    with pytest.raises(NotConnectedError, match="disconnected"):
        camera.next_frame(5.0)
    assert time.monotonic() - began < 3.0


def test_answers_of_random_bytes_end_in_typed_errors(serve) -> None:
    rng = random.Random(4)

    def behave(connection: socket.socket, request: bytes) -> None:
        good = HEAD % (b"b", rng.choice((b"", b"Transfer-Encoding: chunked\r\n", b"Content-Length: 90\r\n")))
        answer = bytearray(good + b"--b\r\n\r\n" + JPEGS[0][:100] + rng.randbytes(rng.randrange(200)))
        for _ in range(rng.randrange(8)):
            answer[rng.randrange(len(answer))] = rng.randrange(256)
        connection.sendall(answer[: rng.randrange(len(answer))])

    url = serve(behave).url
    for _ in range(300):
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
    "url", ["ftp://host/x", "http://", "http://host:99999/", "http://host:0/", "rtsp://h/"]
)
def test_addresses_that_can_never_work_are_refused(url: str) -> None:
    with pytest.raises(InputError, match="not an address"):
        split_url(url)


def test_settings_that_are_refused_name_the_address_and_the_settings(serve) -> None:
    url = serve(answer(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")).url
    with pytest.raises(DeviceError, match=r"settings \{'rate_hz': 7\} failed: .* 400"):
        send_settings(url, {"rate_hz": 7})


def test_a_name_and_password_in_the_address_are_sent(serve) -> None:
    seen: list[bytes] = []

    def behave(connection: socket.socket, request: bytes) -> None:
        seen.append(request)
        plain(connection)

    camera = ExternalCamera("C1", serve(behave).url.replace("//", "//user:p%40ss@"), 30.0)
    camera.connect()
    camera.disconnect()
    assert b"Authorization: Basic dXNlcjpwQHNz" in seen[0]
