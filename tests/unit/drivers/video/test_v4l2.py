"""The V4L2 side of the drivers, against an object with the methods of `cv2.VideoCapture`.

It behaves like the capture in OpenCV's source code. No video device was available, so these tests check only
the driver's side of the interface.
"""

import time
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.images import encode_jpeg
from drivers.video.digit import Digit, light_value
from drivers.video.external_camera import ExternalCamera
from drivers.video.stream import decode
from drivers.video.v4l2 import VideoNode
from fakes.gel.sensor import GelSensor
from support.connected import connected

GEL = GelSensor(8)
MJPG, YUYV = cv2.VideoWriter.fourcc(*"MJPG"), cv2.VideoWriter.fourcc(*"YUYV")
NODES = [
    VideoNode("/dev/video0", "D1", "DIGIT", "0200", "usb1", "1-2"),
    VideoNode("/dev/video2", "D2", "DIGIT", "0200", "usb1", "1-3"),
]


PERIOD_S = 0.008


class FakeCapture:
    """A UVC camera behind OpenCV: formats, buffers with kernel times, and what goes wrong."""

    def __init__(self, jpeg: bool = True, sends: int = 10_000, opens: bool = True, zoom: bool = True) -> None:
        self._offers_jpeg, self._left, self._opens, self._has_zoom = jpeg, sends, opens, zoom
        self.set_log: list[tuple[int, float]] = []
        self.released = False
        self._values: dict[int, float] = {cv2.CAP_PROP_FOURCC: YUYV}
        self._start_s = time.monotonic()
        self.number = 0
        self.lost = 0

    def isOpened(self) -> bool:  # noqa: N802
        return self._opens

    def set(self, kind: int, value: float) -> bool:
        self.set_log.append((kind, value))
        if (kind == cv2.CAP_PROP_FOURCC and not self._offers_jpeg) or (
            kind == cv2.CAP_PROP_ZOOM and not self._has_zoom
        ):
            return False
        self._values[kind] = value
        return True

    def get(self, kind: int) -> float:
        if kind == cv2.CAP_PROP_POS_MSEC:
            return self._stamp_s * 1e3
        return self._values.get(kind, -1.0)

    def read(self) -> tuple[bool, Any]:
        if self._left == 0:
            return False, None
        self._left -= 1
        self.number += 1 + self.lost
        self.lost = 0
        time.sleep(max(self._stamp_s + 0.001 - time.monotonic(), 0.0))
        upright = GEL.render(None, 0.0, np.random.default_rng(self._left))
        raw = np.ascontiguousarray(np.rot90(upright, -1))
        if self._values.get(cv2.CAP_PROP_CONVERT_RGB) == 0:
            return True, np.frombuffer(encode_jpeg(raw), np.uint8)[None, :]
        return True, np.ascontiguousarray(raw[..., ::-1])

    @property
    def _stamp_s(self) -> float:
        """When the kernel filled the newest buffer."""
        return self._start_s + self.number * PERIOD_S

    def release(self) -> None:
        self.released = True


def digit_on(capture: FakeCapture, **arguments: Any) -> Digit:
    return Digit("D1", discover=lambda: NODES, open_device=lambda device: capture, **arguments)


def test_size_is_set_before_rate_and_light_last() -> None:
    capture = FakeCapture()
    digit = digit_on(capture)
    digit.connect()
    digit.disconnect()
    kinds = [kind for kind, _ in capture.set_log]
    order = [cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS]
    assert [kind for kind in kinds if kind in (*order, cv2.CAP_PROP_ZOOM)] == [*order, cv2.CAP_PROP_ZOOM]
    assert (cv2.CAP_PROP_FRAME_WIDTH, 320) in capture.set_log
    assert (cv2.CAP_PROP_ZOOM, 4095) in capture.set_log
    assert capture.released


@pytest.mark.parametrize("jpeg", [True, False])
def test_each_image_is_encoded_once_and_equals_its_decoded_bytes(jpeg: bool) -> None:
    with connected(digit_on(FakeCapture(jpeg))) as digit:
        frames = [digit.next_frame(1.0) for _ in range(12)]
        identity = digit.identity()
    for frame in frames:
        assert frame.image.shape == (320, 240, 3)
        assert frame.jpeg is not None
        assert np.array_equal(decode(frame.jpeg), frame.image)
    assert np.abs(frames[0].image.astype(int) - GEL.render(None, 0.0, np.random.default_rng(1))).mean() < 3.0
    assert identity["firmware"] == "0200"
    assert identity["usb"] == "usb1 port 1-2"
    assert identity["address"] == "/dev/video0"
    assert identity["capture time"] == "kernel"


def test_missing_buffers_are_detected_from_kernel_times() -> None:
    capture = FakeCapture()
    with connected(digit_on(capture)) as digit:
        for _ in range(15):
            digit.next_frame(1.0)
        capture.lost = 7
        frames = [digit.next_frame(1.0).sequence for _ in range(40)]
    assert digit.counters()["dropped"] == 7
    assert sorted(np.diff(frames))[-2:] == [1, 8]


def test_missing_first_image_is_reported_as_bandwidth_on_a_shared_bus_only() -> None:
    digit = digit_on(FakeCapture(sends=0))
    with pytest.raises(DeviceError, match=r"no USB bandwidth is left.*usb1 also carries D2 at /dev/video2"):
        digit.connect()
    capture = FakeCapture(sends=0)
    camera = ExternalCamera("C1", "/dev/video9", discover=lambda: NODES, open_device=lambda device: capture)
    with pytest.raises(DeviceError, match="sends nothing; unplug it"):
        camera.connect()
    assert capture.released


def test_stopped_device_is_reopened() -> None:
    captures = [FakeCapture(sends=20), FakeCapture(opens=False), FakeCapture()]
    with connected(Digit("D1", discover=lambda: NODES, open_device=lambda device: captures.pop(0))) as digit:
        for _ in range(10):
            digit.next_frame(1.0)
        with pytest.raises(DeviceTimeoutError, match="stopped sending"):
            digit.next_frame(0.05)
        digit.next_frame(3.0)
    assert digit.counters()["reopened"] == 1


def test_another_sensor_at_the_address_after_reopening_is_refused() -> None:
    captures = [FakeCapture(sends=20), FakeCapture(), FakeCapture()]
    exchanged = [VideoNode("/dev/video0", "D2", "DIGIT"), VideoNode("/dev/video2", "D1", "DIGIT")]
    nodes = [NODES, exchanged, exchanged, exchanged]
    digit = Digit(
        "left",
        address="/dev/video0",
        discover=lambda: nodes.pop(0) if len(nodes) > 1 else nodes[0],
        open_device=lambda device: captures.pop(0) if len(captures) > 1 else captures[0],
    )
    digit.connect()
    for _ in range(10):
        digit.next_frame(1.0)
    with pytest.raises(DeviceTimeoutError, match="has the serial D2, it had D1: the sensors were exchanged"):
        digit.next_frame(0.5)
    digit.disconnect()


def test_device_that_cannot_be_opened_or_lit_is_reported() -> None:
    with pytest.raises(DeviceError, match="cannot be opened; is it plugged in, unused"):
        digit_on(FakeCapture(opens=False)).connect()
    capture = FakeCapture(zoom=False)
    with pytest.raises(DeviceError, match="zoom control set to 4095"):
        digit_on(capture).connect()
    assert capture.released


def test_light_is_packed_in_the_firmware_format() -> None:
    assert light_value((1.0, 1.0, 1.0), "0200") == 4095
    assert light_value((1.0, 0.0, 0.0), "0200") == 0xF00
    assert light_value((0.0, 1.0, 0.0)) == 0x0F0
    assert light_value((0.0, 0.0, 1.0), "0210") == 0x00F
    assert light_value((1.0, 1.0, 1.0), "0101") == 15
    assert light_value((0.0, 0.0, 0.0), "0101") == 0
