"""From a shot to a picture: decoded, upright, of the size that was asked for."""

from dataclasses import dataclass

import numpy as np

from drivers.errors import DamagedFrameError, DeviceError
from drivers.types import Image
from drivers.video.jpeg import decode, turned_left, whole_jpeg
from drivers.video.stream import RawFrame

_PNG, _PNG_END = b"\x89PNG", b"IEND"


@dataclass(frozen=True, slots=True, eq=False)
class DecodedFrame:
    """A shot made into a picture: (H, W, 3) uint8 RGB, upright, and its bytes where it has any.

    flaw: why it is no picture of the scene ("green", "shifted"); such a frame is withheld.
    """

    image: Image
    jpeg: bytes | None
    flaw: str | None = None


def decode_frame(shot: RawFrame, size_px: tuple[int, int] | None, upright: bool) -> DecodedFrame:
    """Decode a shot. size_px: (width, height) its picture has to have; any when None.

    upright: turn pictures that lie on their side (wider than high) 90 degrees counter-clockwise;
    a JPEG by an orientation header, so that the coded image stays as received.
    Raises `DamagedFrameError`, and `DeviceError` for another size.
    """
    picture = _picture(shot)
    height, width = picture.image.shape[:2]
    if upright and width > height:
        picture = _turned(picture)
        height, width = width, height
    if size_px is not None and (width, height) != tuple(size_px):
        raise DeviceError(
            f"its images are {width} x {height} px, {size_px[0]} x {size_px[1]} are asked for; "
            "correct size_px in the bench file"
        )
    return picture


def _picture(shot: RawFrame) -> DecodedFrame:
    if shot.image is not None:
        return DecodedFrame(shot.image, None)
    data = shot.encoded or b""
    if not data.startswith(_PNG):
        jpeg, _ = whole_jpeg(data)
        return DecodedFrame(decode(jpeg), jpeg)
    if _PNG_END not in data[-16:]:
        raise DamagedFrameError(f"PNG of {len(data)} bytes: its end is missing; copy it anew")
    return DecodedFrame(decode(data), None)


def _turned(picture: DecodedFrame) -> DecodedFrame:
    jpeg = picture.jpeg
    return DecodedFrame(
        np.ascontiguousarray(np.rot90(picture.image)), None if jpeg is None else turned_left(jpeg)
    )
