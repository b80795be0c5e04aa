"""MJPEG servers of all kinds, over real sockets: drawn images, sent as each of them would."""

import contextlib
import random
import socket
import threading
import time
from collections.abc import Callable

import cv2
import numpy as np

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
