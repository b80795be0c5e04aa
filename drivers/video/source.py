"""What the DIGIT and the external camera share: found and opened by an address, read by a thread."""

from abc import abstractmethod

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.formats import without_passwords
from drivers.video.decode import DecodedFrame
from drivers.video.open_stream import OpenSource, SourceSpec, open_source
from drivers.video.reader import FrameReader
from drivers.video.stream import FrameStream, RawFrame
from drivers.video.udev import Discover
from drivers.video.v4l2 import OpenCapture


class AddressedSource(FrameReader):
    """A frame source at an address. Subclasses say what to set after opening, and how a frame is decoded."""

    def __init__(self, spec: SourceSpec, clock: Clock, discover: Discover, open_device: OpenCapture) -> None:
        super().__init__(spec.serial, spec.rate_hz, self._open, self._decode, clock)
        self._spec = spec
        self._clock = clock
        self._discover = discover
        self._open_device = open_device
        self._source: OpenSource | None = None

    def identity(self) -> dict[str, str]:
        """What the device says of itself (as far as it has been opened), and where it was found.

        Keys: serial, model, firmware, usb (bus and port), address, capture time (see `time_kind`).
        """
        source = self._source
        node = source.node if source is not None else None
        return {
            "serial": self.serial,
            "model": node.model if node is not None else "",
            "firmware": node.revision if node is not None else "",
            "usb": f"{node.usb_bus} port {node.usb_port}" if node is not None and node.usb_bus else "",
            "address": without_passwords(source.address) if source is not None else "",
            "capture time": self.time_kind,
        }

    @abstractmethod
    def _prepare(self, source: OpenSource) -> None:
        """Set what is set after opening. Raises `DeviceError`."""

    @abstractmethod
    def _decode(self, raw: RawFrame) -> DecodedFrame:
        """Decode a frame. Raises `DeviceError`."""

    def _open(self) -> FrameStream:
        source = open_source(self._spec, self._clock, self._discover, self._open_device)
        try:
            self._prepare(source)
        except DeviceError:
            source.stream.close()
            raise
        self._source = source
        return source.stream
