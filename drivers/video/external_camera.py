"""The external camera (a video device, MJPEG URL, folder of images or video file), and the GelSight Mini.

A GelSight Mini is a USB camera under a gel with one mode, JPEG of 3280 x 2464 px at 25 Hz (`v4l2-ctl
--list-formats-ext` in github.com/gelsightinc/gsrobotics/issues/36); users of that SDK measured 18 to 25 Hz on
Linux (its issue 6). The SDK cuts a border of 0.15 off each side and scales to 320 x 240 px
(`default_config.json`, `utilities/image_processing.py`); earlier versions cut off 1/7
(`examples/gsdevice.py`). No GelSight Mini was at hand to try this on.
"""

import cv2
import numpy as np

from drivers.clock import Clock, SystemClock
from drivers.interfaces import Camera
from drivers.types import Image
from drivers.video.reader import AddressedSource, SourceSpec
from drivers.video.stream import RawFrame, decode, decode_frame, whole_jpeg
from drivers.video.v4l2 import Discover, OpenCapture, list_video_nodes, open_capture


class ExternalCamera(AddressedSource, Camera):
    """A camera that sees the markers; frames follow the same age and backlog rules as those of any source.

    address: "/dev/videoN", "http://HOST:PORT/PATH", a folder of images or a video file; None finds the USB
    camera with this serial number. rate_hz: the rate to request from a device, to play files at, or to expect
    from a URL. size_px: required width and height of the images; None accepts any size. Raises `InputError`
    for an address that can never be opened.
    """

    def __init__(
        self,
        serial: str,
        address: str | None,
        rate_hz: float = 30.0,
        size_px: tuple[int, int] | None = None,
        clock: Clock | None = None,
        discover: Discover = list_video_nodes,
        open_device: OpenCapture = open_capture,
    ) -> None:
        spec = SourceSpec(serial, address, size_px, rate_hz)
        super().__init__(spec, clock or SystemClock(), discover, open_device)
        self._size_px = size_px

    def _decode(self, raw: RawFrame) -> tuple[Image, bytes | None]:
        return decode_frame(raw, self._size_px, upright=False)


RAW_PX, RATE_HZ = (3280, 2464), 25.0
"""The camera's only mode: width and height, frame rate."""
BORDER = 0.15
"""Share of each side that shows no gel."""
GEL_PX = (320, 240)
"""Width and height of the frames: those of GelSight's own software, and of published frames."""
SHRINK = 4
"""JPEGs of `RAW_PX` are decoded at a quarter of their size: their gel is then still wider than `GEL_PX`."""


class GelSightMini(ExternalCamera):
    """A GelSight Mini, with or without dots on its gel. Parameters: as `ExternalCamera`.

    rate_hz: None for `RATE_HZ`. Devices are asked for `RAW_PX`; addresses and files may have any size.
    """

    def __init__(
        self, serial: str, address: str | None, rate_hz: float | None = None, clock: Clock | None = None
    ) -> None:
        is_device = address is None or address.startswith("/dev/")
        super().__init__(serial, address, rate_hz or RATE_HZ, RAW_PX if is_device else None, clock=clock)

    def _decode(self, raw: RawFrame) -> tuple[Image, bytes | None]:
        if raw.encoded is not None and raw.encoded.startswith(b"\xff\xd8"):
            jpeg, (width, _) = whole_jpeg(raw.encoded)
            return crop_gel(decode(jpeg, SHRINK if width >= RAW_PX[0] else 1)), None
        image, _ = decode_frame(raw, None, upright=False)
        return crop_gel(image), None


def crop_gel(image: Image) -> Image:
    """Cut the border off a GelSight Mini's frame; return (240, 320, 3). Frames of that size are unchanged."""
    height, width = image.shape[:2]
    if (width, height) == GEL_PX:
        return image
    down, across = int(height * BORDER), int(width * BORDER)
    gel = image[down : height - down, across : width - across]
    return np.asarray(cv2.resize(gel, GEL_PX, interpolation=cv2.INTER_AREA), np.uint8)
