"""A DIGIT fingertip sensor: a UVC camera under a gel, found by serial, its LEDs set.

What the makers' digit-interface 0.2.1 says of the device: it streams 640 x 480 at 30 or
15 Hz and 320 x 240 at 60 or 30 Hz, lying on its side; its LEDs are set through the UVC zoom
control, four bits each of red, green and blue (firmware below 2.00: one value for all three).
Its users report first images that are green or dark (its issue 16), reads that hang (17), and
glitches and shifts at 640 x 480 (10). No DIGIT was at hand to try this driver on.
"""

from drivers.clock import Clock, SystemClock
from drivers.errors import DeviceError, InputError, OutOfLimitsError
from drivers.interfaces import TactileSensor
from drivers.video.decode import DecodedFrame, decode_frame
from drivers.video.glitches import GlitchCheck
from drivers.video.mjpeg import MjpegStream
from drivers.video.source import AddressedSource, OpenSource, SourceSpec
from drivers.video.stream import RawFrame
from drivers.video.v4l2 import Discover, OpenCapture, V4l2Stream, list_video_nodes, open_capture

MODES = {(320, 240): (60.0, 30.0), (640, 480): (30.0, 15.0)}
"""Raw width and height in px: frame rates in Hz."""
FULL = 15
OWN_LEDS_SINCE = "0200"
"""USB revision of the first firmware that sets each colour."""


class Digit(AddressedSource, TactileSensor):
    """A DIGIT. serial: as printed on it. size_px: upright width and height.

    address: None finds it by serial; else "/dev/videoN", an MJPEG URL, a folder of images or a
    video file. Raises `InputError` for a mode that a DIGIT does not have.
    """

    def __init__(
        self,
        serial: str,
        rate_hz: float = 60.0,
        size_px: tuple[int, int] = (240, 320),
        address: str | None = None,
        clock: Clock | None = None,
        discover: Discover = list_video_nodes,
        open_device: OpenCapture = open_capture,
    ) -> None:
        raw_px = (size_px[1], size_px[0])
        spec = SourceSpec(serial, address, raw_px, rate_hz)
        if spec.is_device:
            _check_mode(spec)
        super().__init__(spec, clock or SystemClock(), discover, open_device)
        self._size_px = size_px
        self._light = (1.0, 1.0, 1.0)
        self._glitches = GlitchCheck()

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1; they are set again whenever the sensor is opened.

        Raises `OutOfLimitsError`, and `DeviceError` when the source has no LEDs to set.
        """
        if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
            raise OutOfLimitsError(f"{self.serial}: light {(red, green, blue)}: give each colour from 0 to 1")
        self._light = (red, green, blue)
        source = self._source
        if self.connected and source is not None and not self._apply_light(source):
            raise DeviceError(f"{self.serial}: {source.address} has no LEDs to set")

    def connect(self) -> None:
        """Start capturing; the first good image is what later ones are judged by."""
        self._glitches = GlitchCheck()
        super().connect()

    def _prepare(self, source: OpenSource) -> None:
        self._apply_light(source)
        self._glitches.reopened()

    def _decode(self, raw: RawFrame) -> DecodedFrame:
        frame = decode_frame(raw, self._size_px, upright=True)
        return DecodedFrame(frame.image, frame.jpeg, self._glitches.flaw(frame.image))

    def _apply_light(self, source: OpenSource) -> bool:
        """Set the LEDs; False where there are none."""
        stream = source.stream
        if isinstance(stream, V4l2Stream):
            stream.set_zoom(light_value(self._light, source.node.revision if source.node else ""))
        elif isinstance(stream, MjpegStream) and stream.control_url is not None:
            stream.configure([{"light": list(self._light)}])
        else:
            return False
        return True


def light_value(light: tuple[float, float, float], revision: str = "") -> int:
    """Return the zoom control's value for intensities 0 to 1.

    Since firmware 2.00: red, green and blue in four bits each from the top; before: their mean.
    """
    red, green, blue = (round(FULL * value) for value in light)
    if revision and revision < OWN_LEDS_SINCE:
        return round(FULL * sum(light) / 3.0)
    return red << 8 | green << 4 | blue


def _check_mode(spec: SourceSpec) -> None:
    if spec.size_px is None or spec.rate_hz in MODES.get(spec.size_px, ()):
        return
    wide, high = spec.size_px
    modes = "; ".join(
        f"{y} x {x} px at {' or '.join(f'{rate:g}' for rate in rates)} Hz" for (x, y), rates in MODES.items()
    )
    raise InputError(
        f"{spec.serial}: a DIGIT has no {high} x {wide} px at {spec.rate_hz:g} Hz; it has {modes}"
    )
