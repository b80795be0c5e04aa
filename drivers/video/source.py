"""A frame source by its address: device node, MJPEG URL, folder of images or video file.

`AddressedSource` is the common base class of the DIGIT and the external camera.
"""

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path

from drivers.clock import Clock, require_full_speed
from drivers.errors import DeviceError, InputError
from drivers.formats import without_passwords
from drivers.video.files import FolderStream, VideoStream, check_video, image_files
from drivers.video.mjpeg import MjpegStream, split_url
from drivers.video.reader import FrameReader
from drivers.video.stream import DecodedFrame, FrameStream, RawFrame
from drivers.video.v4l2 import Discover, OpenCapture, V4l2Stream, VideoNode, find_video_node, on_same_bus


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """Which source to open. size_px: raw (width, height); None accepts any size.

    address: "/dev/videoN", "http://HOST:PORT/PATH", a folder or a video file; None finds the device with
    this serial number through `discover`.
    """

    serial: str
    address: str | None
    size_px: tuple[int, int] | None
    rate_hz: float

    def __post_init__(self) -> None:
        """Raise `InputError` for an address, size or rate that can never be opened."""
        if not self.rate_hz > 0:
            raise InputError(f"{self.serial}: rate_hz is {self.rate_hz}; give frames per second")
        if self.size_px is not None and min(self.size_px) < 1:
            raise InputError(f"{self.serial}: size_px is {self.size_px}; give width and height in px")
        address = self.address
        if address is not None and "://" in address:
            split_url(address)
        elif address is not None and not self.is_device:
            path = Path(address)
            if not path.exists():
                raise InputError(
                    f"{self.serial}: '{without_passwords(address)}' does not exist; give /dev/videoN, "
                    "http://HOST:PORT/PATH, a folder of images or a video file"
                )
            (image_files if path.is_dir() else check_video)(path)

    @property
    def is_device(self) -> bool:
        """Whether it is a video device of this computer."""
        return self.address is None or self.address.startswith("/dev/")

    @property
    def host(self) -> str | None:
        """Network host of a stream; None for any other source."""
        return split_url(self.address).hostname if self.address and "://" in self.address else None


@dataclass(frozen=True, slots=True)
class OpenSource:
    """An open stream, and its video device if it belongs to one on this computer."""

    stream: FrameStream
    address: str
    node: VideoNode | None = None


def open_source(spec: SourceSpec, clock: Clock, discover: Discover, open_device: OpenCapture) -> OpenSource:
    """Open a source, and set its size and rate. Raises `DeviceError`."""
    address = spec.address
    if address is None or spec.is_device:
        nodes = discover()
        if address is None:
            node = find_video_node(spec.serial, nodes)
        else:  # udev need not list it
            known = (node for node in nodes if node.device == address)
            node = next(known, VideoNode(address, spec.serial))
        sharing = on_same_bus(node, nodes)
        stream = V4l2Stream(node.device, spec.size_px, spec.rate_hz, clock, open_device, sharing)
        return OpenSource(stream, node.device, node)
    if "://" in address:
        stream = MjpegStream(address, spec.rate_hz, clock)
        try:
            # size before rate, because a new size resets the rate
            size = [] if spec.size_px is None else [{"size_px": list(spec.size_px)}]
            stream.configure([*size, {"rate_hz": spec.rate_hz}])
        except DeviceError:
            stream.close()
            raise
        return OpenSource(stream, address)
    path = Path(address)
    kind = FolderStream if path.is_dir() else VideoStream
    return OpenSource(kind(path, spec.rate_hz, clock), address)


class AddressedSource(FrameReader):
    """A frame source at an address. Subclasses set it up after opening, and decode its frames."""

    def __init__(self, spec: SourceSpec, clock: Clock, discover: Discover, open_device: OpenCapture) -> None:
        super().__init__(spec.serial, spec.rate_hz, self._open, self._decode, clock)
        require_full_speed(clock, spec.serial, spec.host)
        self._spec, self._clock, self._discover = spec, clock, discover
        self._open_device = open_device
        self._source: OpenSource | None = None

    def identity(self) -> dict[str, str]:
        """Return what the device reports about itself (if it has been opened), and where it was found."""
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

    def _prepare(self, source: OpenSource) -> None:
        """Set up a source after it was opened, beyond its size and rate. Raises `DeviceError`."""

    @abstractmethod
    def _decode(self, raw: RawFrame) -> DecodedFrame:
        """Decode a frame. Raises `DeviceError`."""

    def _open(self) -> FrameStream:
        source = open_source(self._spec, self._clock, self._discover, self._open_device)
        try:
            self._require_same_device(source)
            self._prepare(source)
        except DeviceError:
            source.stream.close()
            raise
        self._source = source
        return source.stream

    def _require_same_device(self, source: OpenSource) -> None:
        """Raise `DeviceError` if another device is at the address than when it was last opened."""
        before = self._source.node if self._source is not None else None
        if before is None or source.node is None or not before.serial or not source.node.serial:
            return
        if source.node.serial != before.serial:
            raise DeviceError(
                f"{self.serial}: the device at {source.address} has the serial {source.node.serial}, it had "
                f"{before.serial}: the sensors were exchanged; check their cables, then start again"
            )
