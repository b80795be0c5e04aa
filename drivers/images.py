"""Images as bytes: the one set of encoders and decoders outside the fakes, which keep their own."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike

from drivers.errors import FormatError, InputError, RecordingError
from drivers.formats import MOST_PIXELS, picture_flaw, read_bounded
from drivers.types import Frame, Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
"""Endings of the image files that are read, lower case."""
MOST_BYTES = 200_000_000
"""Of an image file: four bytes of each pixel that is decoded."""
JPEG_QUALITY = 95
"""Of what is kept; a camera's own JPEG is kept as received instead."""


def decode_image(data: bytes, grey: bool = False) -> Image | None:
    """Decode to (H, W, 3) uint8 RGB, or (H, W) where `grey`, upright by an orientation header.

    None where that cannot be done, and where `picture_flaw` says why it is not to be; damage inside a JPEG
    goes unnoticed.
    """
    if picture_flaw(data) is not None:
        return None
    way = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), way)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)


def decode_stored(data: bytes) -> Image:
    """Decode the bytes of a stored image to (H, W, 3) uint8 RGB. Raises `RecordingError` if damaged."""
    image = decode_image(data)
    if image is None:
        raise RecordingError("a stored image cannot be decoded; the recording is damaged")
    return image


def load_image(path: Path, grey: bool = False) -> Image | None:
    """Read an image file as `decode_image` does; None where it is missing, damaged or cut short."""
    try:
        return decode_image(read_bounded(path, MOST_BYTES), grey)
    except FormatError:
        return None


def read_image(path: Path, grey: bool = False) -> Image:
    """Read an image file as `load_image` does. Raises `InputError` naming it."""
    image = load_image(path, grey)
    if image is None:
        why = image_flaw(path) or "is no complete picture"
        raise InputError(f"{path}: {why}: copy it anew or leave it out")
    return image


def image_flaw(path: Path) -> str | None:
    """Say why an image file is not decoded: where it cannot be read, too, or None."""
    try:
        return picture_flaw(read_bounded(path, MOST_BYTES))
    except FormatError as error:
        return str(error).removeprefix(f"{path}: ")


def check_video_size(capture: cv2.VideoCapture, path: Path) -> None:
    """Raise `InputError` for a video whose pictures are larger than any that are read."""
    width, height = capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if width * height > MOST_PIXELS:
        raise InputError(f"{path}: is {width:.0f} x {height:.0f} px; at most {MOST_PIXELS:.2g} px are read")


def encode_jpeg(image: Image, quality: int = JPEG_QUALITY) -> bytes:
    """Encode (H, W, 3) uint8 RGB as JPEG. Raises `RecordingError`."""
    return _encoded(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])


def with_jpeg(frame: Frame) -> Frame:
    """Return a frame that has its JPEG, so that a recording and an estimator get the same image.

    A frame without JPEG is encoded here, once, and its image is replaced by the decoded JPEG. Raises
    `RecordingError`.
    """
    if frame.jpeg is not None:
        return frame
    jpeg = encode_jpeg(frame.image)
    return replace(frame, image=decode_stored(jpeg), jpeg=jpeg)


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
