"""Driver of a DIGIT fingertip sensor: a UVC camera under a gel, found by serial number, with coloured LEDs.

From the makers' digit-interface 0.2.1: the sensor streams 640 x 480 px at 30 or 15 Hz and 320 x 240 px at 60
or 30 Hz, rotated by 90 degrees. Its LEDs are set through the UVC zoom control, four bits each for red, green
and blue (firmware before 2.00: one value for all three). Its users report first images that are green or dark
(its issue 16), reads that hang (17), and glitches and shifted images at 640 x 480 (10). This driver has not
been tried on a real DIGIT.

Images of aborted transfers or with lost bytes are detected. The checks cannot reject what an elastomer under
fixed LEDs shows: its background has neither a step along the image nor a constant colour.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, SystemClock
from drivers.errors import DamagedFrameError, DeviceError, InputError, OutOfLimitsError
from drivers.interfaces import TactileSensor
from drivers.types import Image
from drivers.video.mjpeg import MjpegStream
from drivers.video.reader import AddressedSource, SourceSpec
from drivers.video.stream import FrameStream, RawFrame, decode_frame
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
        if spec.is_device and rate_hz not in MODES.get(raw_px, ()):
            modes = "; ".join(
                f"{y} x {x} px at {' or '.join(f'{rate:g}' for rate in rates)} Hz"
                for (x, y), rates in MODES.items()
            )
            raise InputError(
                f"{serial}: a DIGIT has no {raw_px[1]} x {raw_px[0]} px at {rate_hz:g} Hz; it has {modes}"
            )
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
        if self.connected and self._opened is not None and not self._apply_light(self._opened):
            raise DeviceError(f"{self.serial}: {self._spec.address} has no LEDs to set")

    def connect(self) -> None:
        """Start capturing. The first good image is the reference for checking later images."""
        self._glitches = GlitchCheck()
        super().connect()

    def _prepare(self, stream: FrameStream) -> None:
        self._apply_light(stream)
        self._glitches.note_reopening()

    def _decode(self, raw: RawFrame) -> tuple[Image, bytes | None]:
        image, jpeg = decode_frame(raw, self._size_px, upright=True)
        if (flaw := self._glitches.flaw(image)) is not None:
            raise DamagedFrameError(f"its images are {flaw}; check its cable", flaw)
        return image, jpeg

    def _apply_light(self, stream: FrameStream) -> bool:
        """Set the LEDs; return False if the source has none."""
        if isinstance(stream, V4l2Stream):
            stream.set_zoom(light_value(self._light, stream.node.revision))
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


BANDS = 4
"""Bytes may be lost half-way through an image, so its columns are checked in four groups."""
MAX_SHIFTED = 30
"""After this many shifted images in a row the stream does not recover without reopening."""
_STEP_PX = 8
"""Spacing of the rows and columns that are checked for green."""
_DEAD_SHARE = 0.1
"""Fraction of empty columns from which an image is green."""
_GREEN_OVER = 60
"""Grey levels by which green exceeds red and blue in an empty column; it is 135 in an empty buffer."""
_FLAT = 16
"""Largest range of grey levels along an empty column, which is constant except for JPEG artefacts."""
_LEAST_CHANGE = 1.5
"""Mean change of a profile, grey levels, below which no shift is searched."""
_LEAST_SHIFT_PX = 3
"""Smallest shift that is searched."""
_MOST_REST = 0.1
"""Largest squared difference after shifting back, relative to the one before."""
_SEAM_OVER = 1.4
"""Least step at the seam of a shift, relative to the 90 % quantile of all steps. It is low, because the edges
of an object are as steep, and JPEG blurs a seam."""


class GlitchCheck:
    """Checks the images of one stream, each (H, W, 3) uint8 RGB and upright, against the last good image.

    A raw line of a DIGIT is a column of its upright image.
    """

    def __init__(self) -> None:
        self._good: NDArray[np.float32] | None = None
        self._shifted = 0

    def note_reopening(self) -> None:
        """Note that the stream was reopened. The last good image is kept as the reference."""
        self._shifted = 0

    def flaw(self, image: Image) -> str | None:
        """Return "green" or "shifted", or None for a good image.

        Raises `DeviceError` after MAX_SHIFTED shifted images in a row: the stream must then be reopened.
        """
        if is_green(image):
            return "green"
        # the mean colour of each row in each group of columns, (H, 4, 3)
        small = cv2.resize(image, (BANDS, image.shape[0]), interpolation=cv2.INTER_AREA)
        profile = np.asarray(small, np.float32)
        if self._good is not None and self._good.shape == profile.shape and is_shifted(self._good, profile):
            self._shifted += 1
            if self._shifted >= MAX_SHIFTED:
                raise DeviceError(f"{MAX_SHIFTED} images in a row are shifted; use 320 x 240 px")
            return "shifted"
        self._good, self._shifted = profile, 0
        return None


def is_green(image: Image) -> bool:
    """Whether at least a tenth of the image's columns are an empty buffer.

    An empty YUV buffer (all zero) is displayed as a constant green, (0, 135, 0) by ITU-R BT.601.
    """
    sample = image[::_STEP_PX, ::_STEP_PX].astype(np.int16)
    flat = (np.ptp(sample, axis=0) <= _FLAT).all(axis=1)
    red, green, blue = sample.mean(axis=0).T
    dead = flat & (green - np.maximum(red, blue) > _GREEN_OVER)
    return bool(dead.mean() >= _DEAD_SHARE)


def is_shifted(good: NDArray[np.float32], seen: NDArray[np.float32]) -> bool:
    """Whether a profile (H, 4, 3) is a circular shift of the good one along its first axis, in any band.

    Three conditions: it differs from the good profile; after shifting it back, the difference is nearly zero;
    and at the seam it has a step that the good profile has nowhere.
    """
    change = np.abs(seen - good).mean(axis=(0, 2))
    return any(_is_shift(good[:, band], seen[:, band]) for band in np.flatnonzero(change > _LEAST_CHANGE))


def _is_shift(good: NDArray[np.float32], seen: NDArray[np.float32]) -> bool:
    rows = len(good)
    spectrum = np.fft.rfft(seen, axis=0) * np.conj(np.fft.rfft(good, axis=0))
    # the circular shift with the largest correlation, summed over the colours
    shift = int(np.fft.irfft(spectrum.sum(axis=1), n=rows).argmax())
    if min(shift, rows - shift) < _LEAST_SHIFT_PX:
        return False
    before = float(np.square(seen - good).mean())
    after = float(np.square(seen - np.roll(good, shift, axis=0)).mean())
    steps = np.abs(np.diff(seen, axis=0)).sum(axis=1)
    seam = float(steps[max(shift - 2, 0) : shift + 1].max())
    return after < _MOST_REST * before and seam > _SEAM_OVER * float(np.quantile(steps, 0.9))
