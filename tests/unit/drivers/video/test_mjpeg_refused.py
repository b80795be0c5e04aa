"""MJPEG servers that send no stream, damage it or fall silent are rejected with their address."""

import random
import socket
import time
from collections.abc import Callable

import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError
from drivers.video.external_camera import ExternalCamera
from drivers.video.mjpeg import MjpegStream, send_settings, split_url
from support.connected import connected
from support.mjpeg_servers import HEAD, JPEGS, Behaviour, answer, plain, silent_after
from support.waiting import LIMIT_S


def test_damaged_images_are_withheld_counted_and_named(serve) -> None:
    def behave(connection: socket.socket, request: bytes) -> None:
        connection.sendall(HEAD % (b"b", b""))
        connection.sendall(b"--b\r\n\r\n" + JPEGS[0] + b"\r\n")
        for _ in range(60):
            connection.sendall(b"--b\r\n\r\n" + JPEGS[1][:900] + b"\r\n")
            time.sleep(0.01)

    with connected(ExternalCamera("C1", serve(behave).url, 30.0)) as camera:
        assert camera.next_frame(1.0).jpeg == JPEGS[0]
        with pytest.raises(DeviceTimeoutError, match="its end is missing"):
            camera.next_frame(0.2)
    assert camera.counters()["damaged"] > 5


def test_images_of_another_size_are_refused_and_named(serve) -> None:
    camera = ExternalCamera("C1", serve(lambda c, _: plain(c)).url, 30.0, (640, 480))
    with pytest.raises(DeviceError, match=r"C1: its images are 64 x 48 px, expected 640 x 480"):
        camera.connect()


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (answer(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"), "404 Not Found; check the address"),
        (answer(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<p>"), "sends 'text/html'"),
        (answer(b"\x00\xff nonsense\r\n\r\n"), "check the server"),
        (answer(b""), "check the server"),
        (answer(HEAD % (b"b", b"")), "closed the connection"),
        (answer(HEAD % (b"b", b"Transfer-Encoding: chunked\r\n") + b"zz\r\n"), "check the server"),
        (silent_after(0, 2.5), "no image within"),
    ],
)
def test_server_without_a_stream_is_refused_and_named(serve, behaviour: Behaviour, message: str) -> None:
    camera = ExternalCamera("C1", serve(behaviour).url, 30.0)
    with pytest.raises(DeviceError, match=message):
        camera.connect()
    with pytest.raises(NotConnectedError, match="connect"):
        camera.next_frame(0.1)


def test_closed_port_is_reported_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="the connection was refused"):
        ExternalCamera("C1", f"http://127.0.0.1:{port}/video").connect()


def test_silent_server_times_out_and_is_reopened(serve) -> None:
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
def test_random_replies_give_typed_errors(serve, cases: Callable[[int], int]) -> None:
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
    "url", ["ftp://host/x", "http://", "http://host:99999/", "http://host:0/", "rtsp://h/"]
)
def test_invalid_addresses_are_rejected(url: str) -> None:
    with pytest.raises(InputError, match="not an address"):
        split_url(url)


def test_refused_settings_are_reported_with_address_and_values(serve) -> None:
    url = serve(answer(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")).url
    with pytest.raises(DeviceError, match=r"settings \{'rate_hz': 7\} failed: .* 400"):
        send_settings(url, {"rate_hz": 7})


def test_error_messages_contain_no_password() -> None:
    for address in ("http://me:s3cret@127.0.0.1:9/", "http://127.0.0.1:9/?pwd=s3cret"):
        with pytest.raises(DeviceError) as raised:
            MjpegStream(address, 60.0, SystemClock())
        assert "127.0.0.1:9" in str(raised.value)
        assert "s3cret" not in str(raised.value)
        with pytest.raises(DeviceError) as raised:
            send_settings(address, {"rate_hz": 30})
        assert "s3cret" not in str(raised.value)
    with pytest.raises(InputError) as wrong:
        split_url("ftp://me:s3cret@camera/")
    assert "s3cret" not in str(wrong.value)
