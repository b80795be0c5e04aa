"""The external camera: a video device, an MJPEG URL, a folder of images or a video file."""

from drivers.clock import Clock, SystemClock
from drivers.interfaces import Camera
from drivers.video.decode import DecodedFrame, decode_frame
from drivers.video.source import AddressedSource, OpenSource, SourceSpec
from drivers.video.stream import RawFrame
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

    def _prepare(self, source: OpenSource) -> None:
        """Set nothing: size and rate are already set."""

    def _decode(self, raw: RawFrame) -> DecodedFrame:
        return decode_frame(raw, self._size_px, upright=False)
