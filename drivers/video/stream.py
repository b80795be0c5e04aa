"""An open frame source: its raw frames, their capture times and sequence numbers, and their decoding.

OpenCV decodes without an error a JPEG that runs into the next one, or whose data are corrupted, so the
structure is checked first (markers: ITU-T T.81, table B.1; byte stuffing: B.1.1.5). Pillow detects as much as
this check (100 % of truncated and spliced images, 20 % of those with 64 random bytes inside), but only by
decoding, 0.1 ms slower than OpenCV. The check takes 0.01 ms, and the header must be read in any case, because
a stream may not announce the size of its images.
"""

import re
from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Protocol

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import DamagedFrameError, DeviceError, FormatError
from drivers.formats import MOST_PIXELS, jpeg_header
from drivers.images import decode_image
from drivers.types import Image

MAX_DELAY_NS = NS_PER_S
"""If the first time stamp is older than its arrival by more than this, or newer, it is from another clock."""
WARM_UP_IMAGES = 10
"""Images to discard after opening a camera: the first ones of a DIGIT may be green or dark."""
_INTERVALS = 31
"""Number of newest frame intervals of which the median is taken."""
_ENOUGH = 8
"""Fewest intervals before the median is used."""


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One image as received: either encoded bytes or pixels.

    encoded: a JPEG; from files also a PNG. image: (H, W, 3) uint8 RGB. arrived_ns: monotonic time at which
    the last byte was received. stamped_ns: capture time from the source, ns of an unspecified clock. number:
    number of images captured by the source, if it counts them.
    """

    arrived_ns: int
    encoded: bytes | None = None
    image: Image | None = None
    stamped_ns: int | None = None
    number: int | None = None


class FrameStream(Protocol):
    """An open source. One thread reads and closes it; any other thread may interrupt it."""

    warm_up: int
    """Number of images to discard after opening, while exposure and LEDs settle."""
    stamp: str
    """Origin of `stamped_ns`: "kernel", "peer" or "schedule"."""
    ends: bool
    """Whether the source has a last image, as a file has; it is then not reopened."""

    def read(self) -> RawFrame:
        """Wait for the next image. Raises `DeviceError` if no more images will arrive."""
        ...

    def interrupt(self) -> None:
        """End a `read` in progress, if possible; it then raises `DeviceError`."""

    def close(self) -> None:
        """Close the source. Safe to call twice."""


class CaptureTimes:
    """Chooses the capture time of each image of a stream: the source's time stamp, or the arrival time.

    The first time stamp decides. If it is at most a second before its arrival, it is from this computer's
    monotonic clock; otherwise it is from another clock (of a remote computer, or the time of day).
    """

    def __init__(self, stamp: str) -> None:
        self._stamp = stamp
        self._trusted: bool | None = None
        self._last_ns = -1

    @property
    def kind(self) -> str:
        """Origin of the times: "kernel", "peer", "schedule", or "arrival"."""
        return self._stamp if self._trusted else "arrival"

    def time_of(self, raw: RawFrame) -> int:
        """Return an image's capture time, monotonic ns; always later than that of the previous image."""
        stamped = raw.stamped_ns
        if self._trusted is None:
            self._trusted = stamped is not None and 0 <= raw.arrived_ns - stamped < MAX_DELAY_NS
        usable = self._trusted and stamped is not None and self._last_ns < stamped <= raw.arrived_ns
        time_ns = stamped if usable and stamped is not None else raw.arrived_ns
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns


class SequenceCounter:
    """Numbers the images of a source and counts dropped ones.

    The source's own numbers are used if it has any. Otherwise, if the source provides capture times, an
    interval of about n periods means n - 1 dropped images. Arrival times are not used, because a late image
    is not a dropped one. rate_hz: frame rate with which images during an interruption are counted.
    """

    def __init__(self, rate_hz: float) -> None:
        self.dropped = 0
        self._rate_hz = rate_hz
        self._last: int | None = None
        self._last_ns = self._offset = 0
        self._interrupted = False
        self._gap_counts = True
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def note_opening(self, after_failure: bool) -> None:
        """Note that the source was opened: its frame numbers may restart.

        after_failure: images since the last one count as dropped.
        """
        self._interrupted = self._last is not None
        self._gap_counts = after_failure or self._last is None
        self._intervals.clear()

    def sequence_of(self, number: int | None, time_ns: int, stamped: bool) -> int:
        """Return an image's sequence number. stamped: whether `time_ns` is its capture time."""
        interval_ns, self._last_ns = time_ns - self._last_ns, time_ns
        if self._last is None:
            self._last = number or 0
            return self._last
        step = self._step(self._last, number, interval_ns, stamped)
        self.dropped += step - 1 if self._gap_counts else 0
        self._interrupted, self._gap_counts = False, True
        self._intervals.append(max(interval_ns // step, 1))
        self._last += step
        return self._last

    def _step(self, last: int, number: int | None, interval_ns: int, stamped: bool) -> int:
        if number is not None and number + self._offset > last:
            return number + self._offset - last
        step = 1
        if self._interrupted:
            step = max(round(interval_ns * self._rate_hz / NS_PER_S), 2)
        elif number is None and stamped and len(self._intervals) >= _ENOUGH:
            periods = interval_ns / median(self._intervals)
            step = round(periods) if periods > 1.6 else 1
        self._offset = 0 if number is None else last + step - number
        return step


_START, _END = b"\xff\xd8", b"\xff\xd9"
_NEVER_IN_SCAN = re.compile(rb"\xff[\x01-\xc3\xc5-\xcf\xd8\xd9]")
"""In coded data FF is followed by 00, a restart (D0 to D7), or tables and a further scan."""
_TURN_LEFT = (
    b"\xff\xe1\x00\x22Exif\x00\x00MM\x00\x2a\x00\x00\x00\x08"
    b"\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x08\x00\x00\x00\x00\x00\x00"
)
"""An EXIF segment with one entry: orientation (0x0112) = 8, display rotated 90 degrees left."""
_PNG, _PNG_END = b"\x89PNG", b"IEND"


def whole_jpeg(data: bytes) -> tuple[bytes, tuple[int, int]]:
    """Return a JPEG without the padding after it, and its (width, height) in px.

    Raises `DamagedFrameError` if the start, the coded data or the end are not valid.
    """
    size, scan = read_header(data)
    end = data.rfind(_END, scan)
    if end < 0:
        raise DamagedFrameError(f"image of {len(data)} bytes: its end is missing; check the cable")
    if _NEVER_IN_SCAN.search(data, scan, end):
        raise DamagedFrameError(f"image of {len(data)} bytes: corrupted inside; check the cable")
    return data[: end + 2], size


def read_header(data: bytes | bytearray) -> tuple[tuple[int, int], int]:
    """Return (width, height) in px and the offset of the coded data. Raises `DamagedFrameError`."""
    if data[:2] != _START:
        raise DamagedFrameError(f"image begins with {bytes(data[:2]).hex()}, not ffd8: not a JPEG")
    try:
        size, scan = jpeg_header(data)
    except FormatError as error:
        raise DamagedFrameError(f"image of {len(data)} bytes {error}") from error
    if not 0 < size[0] * size[1] <= MOST_PIXELS:
        raise DamagedFrameError(f"image header gives {size}; at most {MOST_PIXELS} px are read")
    return size, scan


def turned_left(jpeg: bytes) -> bytes:
    """Return a JPEG that viewers and `decode` show rotated 90 degrees counter-clockwise.

    An orientation header (EXIF 2.32, tag 0x0112) is inserted. The coded image stays as received; encoding it
    again would change it.
    """
    return _START + _TURN_LEFT + jpeg[2:]


def decode(encoded: bytes, shrink: int = 1) -> Image:
    """Decode to (H, W, 3) uint8 RGB, upright by its orientation header. Raises `DamagedFrameError`.

    shrink: as `decode_image`.
    """
    image = decode_image(encoded, shrink=shrink)
    if image is None:
        raise DamagedFrameError(f"image of {len(encoded)} bytes: cannot be decoded; check the cable")
    return image


def decode_frame(raw: RawFrame, size_px: tuple[int, int] | None, upright: bool) -> tuple[Image, bytes | None]:
    """Return the upright image of a raw frame, (H, W, 3) uint8 RGB, and its JPEG if it was received as JPEG.

    size_px: required (width, height) of the image; None accepts any size. upright: rotate images that are
    wider than high by 90 degrees counter-clockwise; a JPEG by an orientation header, so that the coded image
    stays as received. Raises `DamagedFrameError`, and `DeviceError` for another size.
    """
    data, jpeg = raw.encoded or b"", None
    if raw.image is not None:
        image = raw.image
    elif data.startswith(_PNG):
        if _PNG_END not in data[-16:]:
            raise DamagedFrameError(f"PNG of {len(data)} bytes: its end is missing; copy it again")
        image = decode(data)
    else:
        jpeg, _ = whole_jpeg(data)
        image = decode(jpeg)
    height, width = image.shape[:2]
    if upright and width > height:
        image, jpeg = np.ascontiguousarray(np.rot90(image)), jpeg and turned_left(jpeg)
        height, width = width, height
    if size_px is not None and (width, height) != tuple(size_px):
        raise DeviceError(
            f"its images are {width} x {height} px, expected {size_px[0]} x {size_px[1]}; "
            "correct size_px in the bench file"
        )
    return image, jpeg
