"""Driver of a DIGIT fingertip sensor: a UVC camera under a gel, found by serial number, with coloured LEDs.

From the makers' digit-interface 0.2.1: the sensor streams 640 x 480 px at 30 or 15 Hz and 320 x 240 px at 60
or 30 Hz, rotated by 90 degrees. Its LEDs are set through the UVC zoom control, four bits each for red, green
and blue (firmware before 2.00: one value for all three). Its users report first images that are green or dark
(its issue 16), reads that hang (17), and glitches and shifted images at 640 x 480 (10). This driver has not
been tried on a real DIGIT.
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
"""Largest four-bit LED value."""
OWN_LEDS_SINCE = "0200"
"""USB revision of the first firmware that sets each colour separately."""


class Digit(AddressedSource, TactileSensor):
    """A DIGIT. serial: as printed on it. size_px: width and height of the upright image.

    address: None finds the sensor by its serial number; otherwise "/dev/videoN", an MJPEG URL, a folder of
    images or a video file. Raises `InputError` for a mode that a DIGIT does not have.
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
        """Set the LEDs' intensities, 0 to 1. They are set again whenever the sensor is reopened.

        Raises `OutOfLimitsError`, and `DeviceError` if the source has no LEDs.
        """
        if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
            raise OutOfLimitsError(f"{self.serial}: light {(red, green, blue)}: give each colour from 0 to 1")
        self._light = (red, green, blue)
        source = self._source
        if self.connected and source is not None and not self._apply_light(source):
            raise DeviceError(f"{self.serial}: {source.address} has no LEDs to set")

    def connect(self) -> None:
        """Start capturing. The first good image is the reference for checking later images."""
        self._glitches = GlitchCheck()
        super().connect()

    def _prepare(self, source: OpenSource) -> None:
        self._apply_light(source)
        self._glitches.reopened()

    def _decode(self, raw: RawFrame) -> DecodedFrame:
        frame = decode_frame(raw, self._size_px, upright=True)
        return DecodedFrame(frame.image, frame.jpeg, self._glitches.flaw(frame.image))

    def _apply_light(self, source: OpenSource) -> bool:
        """Set the LEDs; return False if the source has none."""
        stream = source.stream
        if isinstance(stream, V4l2Stream):
            stream.set_zoom(light_value(self._light, source.node.revision if source.node else ""))
        elif isinstance(stream, MjpegStream) and stream.control_url is not None:
            stream.configure([{"light": list(self._light)}])
        else:
            return False
        return True


def light_value(light: tuple[float, float, float], revision: str = "") -> int:
    """Return the value of the zoom control for intensities 0 to 1.

    Firmware 2.00 and later: red, green and blue, four bits each, from the top. Earlier: their mean.
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
