"""Images as bytes: the one set of encoders and decoders outside the fakes, which keep their own."""

from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike

from drivers.errors import InputError, RecordingError
from drivers.types import Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
"""Endings of the image files that are read, lower case."""
JPEG_QUALITY = 95
"""Of what is kept; a camera's own JPEG is kept as received instead."""
_FILE_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND"}
"""How a whole JPEG and PNG end, by how they begin."""


def decode_image(data: bytes, grey: bool = False) -> Image | None:
    """Decode to (H, W, 3) uint8 RGB, or (H, W) where `grey`, upright by an orientation header.

    None where that cannot be done; what is cut short or damaged inside may be decoded as far as it goes.
    """
    way = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), way)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)


def load_image(path: Path, grey: bool = False) -> Image | None:
    """Read an image file as `decode_image` does; None where it is missing, damaged or cut short."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    end = _FILE_ENDS.get(data[:2])
    # In the second half: a JPEG's preview in its head has an end of its own.
    if end is not None and data.rfind(end) < len(data) // 2:
        return None
    return decode_image(data, grey)


def read_image(path: Path, grey: bool = False) -> Image:
    """Read an image file as `load_image` does. Raises `InputError` naming it."""
    image = load_image(path, grey)
    if image is None:
        raise InputError(f"{path}: not a complete image: copy it anew or leave it out")
    return image


def encode_jpeg(image: Image, quality: int = JPEG_QUALITY) -> bytes:
    """Encode (H, W, 3) uint8 RGB as JPEG. Raises `RecordingError`."""
    return _encoded(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])


def encode_png(image: Image) -> bytes:
    """Encode (H, W, 3) uint8 RGB, or a mask (H, W) uint8, as PNG. Raises `RecordingError`."""
    return _encoded(".png", image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [])


def _encoded(suffix: str, image: MatLike, options: list[int]) -> bytes:
    failure = RecordingError(f"an image of shape {image.shape} cannot be encoded as {suffix[1:]}")
    try:
        done, data = cv2.imencode(suffix, image, options)
    except cv2.error as error:
        raise failure from error
    if not done:
        raise failure
    return data.tobytes()
