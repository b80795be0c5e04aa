"""Find video devices (udev), and read frames of one through OpenCV's V4L2 capture.

A UVC camera has a capture node and a metadata node, and their numbers change when it is plugged in again. So
a camera is selected by its serial number and by the capabilities of its node.

With FOURCC MJPG and without conversion, OpenCV returns the undecoded bytes of each buffer (the device's own
JPEG) as one row of uint8 (modules/videoio/src/cap_v4l.cpp, v4l2_create_frame). CAP_PROP_POS_MSEC is the
kernel's time stamp of the buffer, for UVC of CLOCK_MONOTONIC. Neither has been tried on a device.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.images import encode_jpeg
from drivers.video.stream import WARM_UP_IMAGES, FrameStream, RawFrame

OpenCapture = Callable[[str], Any]
"""Opens a device; the result has the methods of `cv2.VideoCapture`."""


@dataclass(frozen=True, slots=True)
class VideoNode:
    """A node that captures. revision: of the firmware, in the form of USB ("0200" is 2.00).

    usb_bus: root hub of the device, whose bandwidth it shares; usb_port: its port there.
    """

    device: str
    serial: str
    model: str = ""
    revision: str = ""
    usb_bus: str = ""
    usb_port: str = ""


Discover = Callable[[], Sequence[VideoNode]]


def list_video_nodes() -> list[VideoNode]:
    """List the video devices that capture, from udev. Raises `DeviceError` if there is no udev."""
    try:
        import pyudev
    except ImportError as error:
        raise DeviceError(
            f"video devices: udev is not available ({error}); give the device's address"
        ) from error
    devices = pyudev.Context().list_devices(subsystem="video4linux")
    return [_node(device) for device in devices if _captures(device)]


def find_video_node(serial: str, nodes: Sequence[VideoNode]) -> VideoNode:
    """Return the only node with this serial. Raises `DeviceError` if there is none, or more than one."""
    found = [node for node in nodes if node.serial == serial]
    if len(found) == 1:
        return found[0]
    if found:
        where = ", ".join(node.device for node in found)
        raise DeviceError(f"{serial}: {len(found)} devices have this serial ({where}); unplug all but one")
    there = ", ".join(f"{node.serial} at {node.device}" for node in nodes) or "no video device"
    raise DeviceError(f"{serial}: not plugged in; udev lists {there}; check its cable and the serial")


def on_same_bus(node: VideoNode, nodes: Sequence[VideoNode]) -> list[VideoNode]:
    return [other for other in nodes if other.usb_bus == node.usb_bus != "" and other.device != node.device]


def _captures(device: Any) -> bool:
    """Whether a node captures: from udev's probe (v4l_id), or, if that did not run, from the node's index."""
    able = device.properties.get("ID_V4L_CAPABILITIES")
    if able is not None:
        return ":capture:" in able
    index = device.attributes.get("index")
    return index is None or index.strip() == b"0"


def _node(device: Any) -> VideoNode:
    names = ("ID_SERIAL_SHORT", "ID_MODEL", "ID_REVISION")
    serial, model, revision = (device.properties.get(name, "") for name in names)
    parent = device.find_parent("usb", "usb_device")
    port = "" if parent is None else parent.sys_name  # such as "1-2.3", on the root hub "usb1"
    bus = port and f"usb{port.split('-')[0]}"
    return VideoNode(device.device_node or "", serial, model, revision, bus, port)


def open_capture(device: str) -> cv2.VideoCapture:
    """Open a device node with OpenCV's V4L2 backend, without its warnings on stderr."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    return cv2.VideoCapture(device, cv2.CAP_V4L2)


class V4l2Stream(FrameStream):
    """An open device, with its size and then its rate set (a new size resets the rate).

    size_px: raw width and height. sharing: devices on the same USB bus. Raises `DeviceError` if the node
    cannot be opened or does not offer the size.
    """

    warm_up = WARM_UP_IMAGES
    stamp = "kernel"
    ends = False

    def __init__(
        self,
        node: VideoNode,
        size_px: tuple[int, int] | None,
        rate_hz: float,
        clock: Clock,
        open_device: OpenCapture = open_capture,
        sharing: Sequence[VideoNode] = (),
    ) -> None:
        self.node, self._sharing, self._clock = node, sharing, clock
        self._capture = open_device(node.device)
        self._received_any = False
        try:
            if not self._capture.isOpened():
                raise DeviceError(
                    f"{node.device}: cannot be opened; is it plugged in, unused, and readable for you?"
                )
            jpeg = cv2.VideoWriter.fourcc(*"MJPG")
            self._capture.set(cv2.CAP_PROP_FOURCC, jpeg)
            self._encoded = int(self._capture.get(cv2.CAP_PROP_FOURCC)) == jpeg
            self._set_size(size_px)
            self._capture.set(cv2.CAP_PROP_FPS, rate_hz)
            self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if self._encoded else 1)
        except DeviceError:
            self.close()
            raise

    def read(self) -> RawFrame:
        """Wait for the next buffer; OpenCV waits at most 10 s."""
        there, data = self._capture.read()
        if not there or data is None:
            raise DeviceError(f"{self.node.device}: {self._no_image()}")
        self._received_any = True
        arrived_ns = self._clock.now_ns()
        stamped_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        # A device without JPEG is encoded here, once, so that the stored image is the one that is estimated.
        encoded = data.tobytes() if self._encoded else encode_jpeg(np.asarray(data[..., ::-1], np.uint8))
        return RawFrame(arrived_ns, encoded, None, stamped_ns if stamped_ns > 0 else None)

    def set_zoom(self, value: int) -> None:
        """Set the UVC zoom control. Raises `DeviceError` if the device does not accept the value."""
        taken = self._capture.set(cv2.CAP_PROP_ZOOM, value)
        seen = round(self._capture.get(cv2.CAP_PROP_ZOOM))
        if not taken or seen != value:
            raise DeviceError(
                f"{self.node.device}: zoom control set to {value}, reads {seen}; is it a DIGIT?"
            )

    def interrupt(self) -> None:
        """Do nothing: a capture that waits in the kernel must not be released."""

    def close(self) -> None:
        self._capture.release()

    def _set_size(self, size_px: tuple[int, int] | None) -> None:
        if size_px is None:
            return
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
        kinds = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        seen = tuple(round(self._capture.get(kind)) for kind in kinds)
        if seen != tuple(size_px):
            raise DeviceError(
                f"{self.node.device}: asked for {size_px[0]} x {size_px[1]} px, it gives {seen[0]} x "
                f"{seen[1]}; correct size_px in the bench file"
            )

    def _no_image(self) -> str:
        if self._received_any:
            return "it stopped sending; check its cable"
        if not self._sharing:
            return "opened, but it sends nothing; unplug it and plug it in again"
        others = ", ".join(f"{node.serial or node.model} at {node.device}" for node in self._sharing)
        return (
            "opened, but it sends nothing: most likely no USB bandwidth is left (the "
            "kernel log then says 'not enough bandwidth' or 'No space left on device'). Bus "
            f"{self._sharing[0].usb_bus} also carries {others}: plug one of them into another host "
            "controller (a hub does not help), or lower rate_hz"
        )
