"""The external camera: a video device, an MJPEG URL, a folder of images or a video file."""

from drivers.clock import Clock, SystemClock
from drivers.interfaces import Camera
from drivers.video.decode import DecodedFrame, decode_frame
from drivers.video.source import AddressedSource, OpenSource, SourceSpec
from drivers.video.stream import RawFrame
from drivers.video.v4l2 import Discover, OpenCapture, list_video_nodes, open_capture


class ExternalCamera(AddressedSource, Camera):
    """A camera that sees the markers, with the freshness rules of every frame source.

    address: "/dev/videoN", "http://HOST:PORT/PATH", a folder of images or a video file; None
    finds the USB camera with this serial. rate_hz: asked of a device, the pace of files, what is
    expected of a URL. size_px: width and height its images must have; any when None.
    Raises `InputError` for an address that can never be opened.
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

    def _prepare(self, source: OpenSource) -> None:
        """Nothing but size and rate is set."""

    def _decode(self, raw: RawFrame) -> DecodedFrame:
        return decode_frame(raw, self._size_px, upright=False)
