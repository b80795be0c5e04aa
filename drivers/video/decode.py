"""From a raw frame to a decoded one: upright, of the size that was asked for."""

from dataclasses import dataclass

import numpy as np

from drivers.errors import DamagedFrameError, DeviceError
from drivers.types import Image
from drivers.video.jpeg import decode, turned_left, whole_jpeg
from drivers.video.stream import RawFrame

_PNG, _PNG_END = b"\x89PNG", b"IEND"


@dataclass(frozen=True, slots=True, eq=False)
class DecodedFrame:
    """An image, (H, W, 3) uint8 RGB, upright, and its JPEG bytes where it came as JPEG.

    flaw: why it does not show the scene ("green", "shifted"); such a frame is withheld.
    """

    image: Image
    jpeg: bytes | None
    flaw: str | None = None


def decode_frame(raw: RawFrame, size_px: tuple[int, int] | None, upright: bool) -> DecodedFrame:
    """Decode a raw frame. size_px: (width, height) that the image has to have; any when None.

    upright: turn images that lie on their side (wider than high) 90 degrees counter-clockwise;
    a JPEG by an orientation header, so that the coded image stays as received.
    Raises `DamagedFrameError`, and `DeviceError` for another size.
    """
    frame = _decoded(raw)
    height, width = frame.image.shape[:2]
    if upright and width > height:
        frame = _turned(frame)
        height, width = width, height
    if size_px is not None and (width, height) != tuple(size_px):
        raise DeviceError(
            f"its images are {width} x {height} px, {size_px[0]} x {size_px[1]} are asked for; "
            "correct size_px in the bench file"
        )
    return frame


def _decoded(raw: RawFrame) -> DecodedFrame:
    if raw.image is not None:
        return DecodedFrame(raw.image, None)
    data = raw.encoded or b""
    if not data.startswith(_PNG):
        jpeg, _ = whole_jpeg(data)
        return DecodedFrame(decode(jpeg), jpeg)
    if _PNG_END not in data[-16:]:
        raise DamagedFrameError(f"PNG of {len(data)} bytes: its end is missing; copy it anew")
    return DecodedFrame(decode(data), None)


def _turned(frame: DecodedFrame) -> DecodedFrame:
    jpeg = frame.jpeg
    return DecodedFrame(
        np.ascontiguousarray(np.rot90(frame.image)), None if jpeg is None else turned_left(jpeg)
    )
