"""A video device through OpenCV's V4L2 capture: the device's own JPEG bytes where it has them.

With FOURCC MJPG and conversion off, OpenCV hands out each buffer's bytes undecoded, one row of
uint8 (modules/videoio/src/cap_v4l.cpp, v4l2_create_frame), and CAP_PROP_POS_MSEC is the time the
kernel stamped on the buffer, for UVC that of CLOCK_MONOTONIC. Neither was tried on a device.
"""

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.images import encode_jpeg
from drivers.video.stream import FrameStream, RawFrame
from drivers.video.udev import VideoNode

WARM_UP_IMAGES = 10
OpenCapture = Callable[[str], Any]
"""Opens a device; what it returns has the methods of `cv2.VideoCapture`."""


def open_capture(device: str) -> cv2.VideoCapture:
    """Open a device node with OpenCV's V4L2 backend, which need not say on stderr what our errors say."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    return cv2.VideoCapture(device, cv2.CAP_V4L2)


class V4l2Stream(FrameStream):
    """An open device, set to a size, then a rate (a new size resets the rate).

    size_px: raw width and height. sharing: devices on the same USB bus. Raises `DeviceError`
    when the node cannot be opened or does not offer the size.
    """

    warm_up = WARM_UP_IMAGES
    stamp = "kernel"
    ends = False

    def __init__(
        self,
        device: str,
        size_px: tuple[int, int] | None,
        rate_hz: float,
        clock: Clock,
        open_device: OpenCapture = open_capture,
        sharing: Sequence[VideoNode] = (),
    ) -> None:
        self._device = device
        self._sharing = sharing
        self._clock = clock
        self._capture = open_device(device)
        self._any_yet = False
        try:
            if not self._capture.isOpened():
                raise DeviceError(f"{device}: cannot be opened; is it plugged in, free, and yours to read?")
            self._encoded = self._ask_for_jpeg()
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
            raise DeviceError(self._no_image())
        self._any_yet = True
        arrived_ns = self._clock.now_ns()
        stamped_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        # A device without JPEG is encoded here, once, so that what is stored is what is judged.
        encoded = data.tobytes() if self._encoded else encode_jpeg(np.asarray(data[..., ::-1], np.uint8))
        return RawFrame(arrived_ns, encoded, None, stamped_ns if stamped_ns > 0 else None)

    def set_zoom(self, value: int) -> None:
        """Set the UVC zoom control. Raises `DeviceError` when the device does not take it."""
        taken = self._capture.set(cv2.CAP_PROP_ZOOM, value)
        seen = round(self._capture.get(cv2.CAP_PROP_ZOOM))
        if not taken or seen != value:
            raise DeviceError(f"{self._device}: zoom control set to {value}, reads {seen}; is it a DIGIT?")

    def interrupt(self) -> None:
        """Nothing can be done: a capture that waits in the kernel must not be released."""

    def close(self) -> None:
        """Release the device."""
        self._capture.release()

    def _ask_for_jpeg(self) -> bool:
        jpeg = cv2.VideoWriter.fourcc(*"MJPG")
        self._capture.set(cv2.CAP_PROP_FOURCC, jpeg)
        return int(self._capture.get(cv2.CAP_PROP_FOURCC)) == jpeg

    def _set_size(self, size_px: tuple[int, int] | None) -> None:
        if size_px is None:
            return
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
        kinds = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        seen = tuple(round(self._capture.get(kind)) for kind in kinds)
        if seen != tuple(size_px):
            raise DeviceError(
                f"{self._device}: asked for {size_px[0]} x {size_px[1]} px, it gives {seen[0]} x {seen[1]}; "
                "correct size_px in the bench file"
            )

    def _no_image(self) -> str:
        if self._any_yet:
            return f"{self._device}: it stopped sending; check its cable"
        if not self._sharing:
            return f"{self._device}: opened, but it sends nothing; unplug it and plug it in again"
        others = ", ".join(f"{node.serial or node.model} at {node.device}" for node in self._sharing)
        return (
            f"{self._device}: opened, but it sends nothing: most likely no USB bandwidth is left (the "
            "kernel log then says 'not enough bandwidth' or 'No space left on device'). Bus "
            f"{self._sharing[0].usb_bus} also carries {others}: plug one of them into another host "
            "controller (a hub does not help), or lower rate_hz"
        )
