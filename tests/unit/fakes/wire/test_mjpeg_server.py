"""The served sensor as anyone's MJPEG client sees it, and its side channel."""

import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.clock import SystemClock, to_ns
from fakes.clock import SimulatedClock
from fakes.gel.sensor import GelSensor
from fakes.wire.mjpeg.server import MjpegSensor, MjpegServer

GEL = GelSensor(6)


def drawn(time_ns: int) -> np.ndarray:
    return GEL.render(None, 0.0, np.random.default_rng(time_ns))


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    server = MjpegServer("D1", drawn, 60.0, SystemClock())
    server.start()
    yield server
    server.stop()


def post(server: MjpegServer, path: str, body: bytes) -> tuple[int, str]:
    try:
        request = urllib.request.Request(server.url.replace("/stream.mjpg", path), body)
        with urllib.request.urlopen(request, timeout=120) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_opencv_reads_the_stream(server: MjpegServer) -> None:
    capture = cv2.VideoCapture(server.url, cv2.CAP_FFMPEG)
    read = [capture.read() for _ in range(20)]
    capture.release()
    assert all(there for there, _ in read)
    raw = np.rot90(read[-1][1][..., ::-1]).astype(int)
    assert np.abs(raw - drawn(0).astype(int)).mean() < 4.0


@pytest.mark.parametrize(
    ("path", "body", "words"),
    [
        ("/control", b'{"size_px": [800, 600]}', "no size"),
        ("/control", b'{"size_px": [Infinity, NaN]}', "no size"),
        ("/control", b'{"rate_hz": NaN}', "no rate"),
        ("/control", b'{"rate_hz": 61}', "no rate 61"),
        ("/control", b'{"rate_hz": "fast"}', "give 1 number"),
        ("/control", b'{"light": [1, 1]}', "give 3 numbers"),
        ("/control", b'{"light": [2, 0, 0]}', "from 0 to 1"),
        ("/control", b'{"zoom": 1}', "there are size_px"),
        ("/control", b"[1]", "expected a JSON object"),
        ("/control", b"\xff\x00", "expected a JSON object"),
        ("/elsewhere", b"{}", "settings go to /control"),
    ],
)
def test_invalid_settings_are_rejected(server: MjpegServer, path: str, body: bytes, words: str) -> None:
    status, text = post(server, path, body)
    assert status == 400
    assert words in text


@pytest.mark.parametrize("settings", [{"rate_hz": 60}, {"rate_hz": 30}, {"size_px": [320, 240]}])
def test_settings_keep_the_numbers_of_unread_images(settings: dict[str, Any]) -> None:
    clock = SimulatedClock()
    sensor = MjpegSensor(drawn, 60.0, clock, "digit")
    sensor.open()
    first = sensor.capture()
    clock.sleep_until(clock.now_ns() + to_ns(0.5))
    sensor.configure(settings)
    sensor.open()
    later = sensor.capture()
    assert first is not None
    assert later is not None
    assert later.number - first.number == pytest.approx(30, abs=1)
