"""The V4L2 side of the drivers, against an object with the methods of `cv2.VideoCapture`.

It behaves like the capture in OpenCV's source code. No video device was available, so these tests check only
the driver's side of the interface.
"""

import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.images import encode_jpeg
from drivers.video.digit import Digit, light_value
from drivers.video.external_camera import ExternalCamera
from drivers.video.stream import decode
from drivers.video.v4l2 import VideoNode, find_video_node, on_same_bus
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


def digit_on(*captures: FakeCapture, address: str | None = None, nodes: Sequence[Any] = (NODES,)) -> Digit:
    """A DIGIT that gets these captures and lists of nodes in turn, the last one again and again."""
    left, listed = list(captures), list(nodes)
    return Digit(
        "D1",
        address=address,
        discover=lambda: listed.pop(0) if len(listed) > 1 else listed[0],
        open_device=lambda device: left.pop(0) if len(left) > 1 else left[0],
    )


def test_size_is_set_before_rate_and_light_last() -> None:
    capture = FakeCapture()
    with connected(digit_on(capture)):
        pass
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
    expected = {
        "firmware": "0200",
        "usb": "usb1 port 1-2",
        "address": "/dev/video0",
        "capture time": "kernel",
    }
    assert expected.items() <= identity.items()


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
    with connected(digit_on(FakeCapture(sends=20), FakeCapture(opens=False), FakeCapture())) as digit:
        for _ in range(10):
            digit.next_frame(1.0)
        with pytest.raises(DeviceTimeoutError, match="stopped sending"):
            digit.next_frame(0.05)
        digit.next_frame(3.0)
    assert digit.counters()["reopened"] == 1


def test_another_sensor_at_the_address_after_reopening_is_refused() -> None:
    exchanged = [VideoNode("/dev/video0", "D2", "DIGIT")]
    captures = FakeCapture(sends=20), FakeCapture()
    with connected(digit_on(*captures, address="/dev/video0", nodes=(NODES, exchanged))) as digit:
        for _ in range(10):
            digit.next_frame(1.0)
        with pytest.raises(DeviceTimeoutError, match="serial D2, it had D1: the sensors were exchanged"):
            digit.next_frame(0.5)


def test_address_of_another_sensor_is_refused_if_the_serial_is_found_elsewhere() -> None:
    with pytest.raises(DeviceError, match="D1: it is at /dev/video0, and /dev/video2 has the serial D2"):
        digit_on(FakeCapture(), address="/dev/video2").connect()


def test_device_that_cannot_be_opened_or_lit_is_reported() -> None:
    with pytest.raises(DeviceError, match="cannot be opened; is it plugged in, unused"):
        digit_on(FakeCapture(opens=False)).connect()
    capture = FakeCapture(zoom=False)
    with pytest.raises(DeviceError, match="zoom control set to 4095"):
        digit_on(capture).connect()
    assert capture.released


def test_light_is_packed_in_the_firmware_format() -> None:
    for light, revision, value in (
        ((1.0, 1.0, 1.0), "0200", 4095),
        ((1.0, 0.0, 0.0), "0200", 0xF00),
        ((0.0, 1.0, 0.0), "", 0x0F0),
        ((0.0, 0.0, 1.0), "0210", 0x00F),
        ((1.0, 1.0, 1.0), "0101", 15),
        ((0.0, 0.0, 0.0), "0101", 0),
    ):
        assert light_value(light, revision) == value


TABLE = [
    VideoNode("/dev/video0", "D20001", "DIGIT", "0200", "usb1", "1-2"),
    VideoNode("/dev/video2", "D20002", "DIGIT", "0200", "usb1", "1-3"),
    VideoNode("/dev/video4", "C1", "Webcam", "0010", "usb3", "3-1"),
    VideoNode("/dev/video6", "TWIN"),
    VideoNode("/dev/video7", "TWIN"),
]


def test_video_node_is_found_by_its_serial_or_its_absence_reported() -> None:
    assert find_video_node("D20002", TABLE).device == "/dev/video2"
    for serial, nodes, said in (
        ("D9", TABLE, r"D9: not plugged in; udev lists D20001 at /dev/video0, D20002"),
        ("D9", [], "no video device"),
        ("TWIN", TABLE, "2 devices have this serial"),
    ):
        with pytest.raises(DeviceError, match=said):
            find_video_node(serial, nodes)


def test_devices_on_the_same_bus_are_listed() -> None:
    assert on_same_bus(TABLE[0], TABLE) == [TABLE[1]]
    assert on_same_bus(TABLE[3], TABLE) == []


def usb_device(port: str) -> str:
    """A USB device in umockdev's notation."""
    path = f"/devices/pci0000:00/0000:00:14.0/usb1/{port}"
    return f"P: {path}\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: BUSNUM=001\n"


def video_node(name: str, serial: str, revision: str, capabilities: str, port: str) -> str:
    """A video node of a USB device."""
    path = f"/devices/pci0000:00/0000:00:14.0/usb1/{port}/{port}:1.0/video4linux/{name}"
    properties = {
        "DEVNAME": f"/dev/{name}",
        "SUBSYSTEM": "video4linux",
        "ID_MODEL": "DIGIT",
        "ID_SERIAL_SHORT": serial,
        "ID_REVISION": revision,
        "ID_V4L_CAPABILITIES": capabilities,
    }
    return f"P: {path}\nN: {name}\n" + "".join(f"E: {key}={value}\n" for key, value in properties.items())


@pytest.mark.skipif(shutil.which("umockdev-run") is None, reason="umockdev is not installed")
def test_only_capture_nodes_of_udev_are_used(tmp_path: Path) -> None:
    pytest.importorskip("pyudev")
    machine = tmp_path / "machine.umockdev"
    parts = [
        usb_device("1-2"),
        video_node("video0", "D20001", "0200", ":capture:", "1-2"),
        video_node("video1", "D20001", "0200", ":", "1-2"),
        usb_device("1-3"),
        video_node("video2", "D20002", "0101", ":capture:", "1-3"),
    ]
    machine.write_text("\n".join(parts))
    code = (
        "from drivers.video.v4l2 import list_video_nodes as nodes\n"
        "for n in sorted(nodes(), key=lambda n: n.device):\n"
        "    print(n.device, n.serial, n.model, n.revision, n.usb_bus, n.usb_port)"
    )
    command = ["umockdev-run", "-d", str(machine), "--", sys.executable, "-c", code]
    seen = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert seen.stdout.splitlines() == [
        "/dev/video0 D20001 DIGIT 0200 usb1 1-2",
        "/dev/video2 D20002 DIGIT 0101 usb1 1-3",
    ], seen.stderr
