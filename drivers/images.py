"""Image encoders and decoders, shared by everything except the fakes, which keep their own."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike

from drivers.errors import FormatError, InputError, RecordingError, RigError
from drivers.formats import (
    MOST_PIXELS,
    holds_floats,
    in_number_order,
    may_hold_several,
    picture_count,
    picture_flaw,
    read_beginning,
    read_bounded,
)
from drivers.types import Frame, Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
"""File name suffixes of the supported image formats, lower case."""
MOST_BYTES = 200_000_000
"""Size limit of an image file in bytes: four bytes per pixel of the largest image that is decoded."""
BEGINNING_BYTES = 65_536
"""Size of the part that is read of a file that can contain only one picture; other files are read whole."""
REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
JPEG_QUALITY = 95
"""JPEG quality of stored images. A camera's own JPEG is stored as received instead."""


def images_in_order(paths: Iterable[Path], suffixes: Collection[str] = SUFFIXES) -> list[Path]:
    """Return those of the files of a folder that are images, sorted by `in_number_order`; no hidden files."""
    return in_number_order(p for p in paths if p.suffix.lower() in suffixes and not p.name.startswith("."))


def decode_image(data: bytes, grey: bool = False, shrink: int = 1) -> Image | None:
    """Decode to (H, W, 3) uint8 RGB, or (H, W) if `grey`, rotated upright by the orientation header.

    shrink: 2 or 4 decode a colour image at half or a quarter of its size, which is much faster for a JPEG.
    Return None if decoding fails, or if `picture_flaw` rejects the data. Damage inside the coded data of a
    JPEG is not detected.
    """
    if picture_flaw(data) is not None:
        return None
    if holds_floats(data):
        try:
            return _of_floats(data, grey)
        except FormatError:
            return None
    way = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), way if shrink == 1 else REDUCED[shrink])
    except cv2.error:
        return None
    if image is None:
        return None
    return np.asarray(image if shrink == 1 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _of_floats(data: bytes, grey: bool) -> Image:
    """Decode a TIFF with floating-point samples, of 0 to 1 or of 0 to 255. Raises `FormatError`."""
    import tifffile

    try:
        with tifffile.TiffFile(BytesIO(data)) as file:
            values = np.asarray(file.pages.first.asarray(), np.float64)
    except RigError:  # a stop by the operator
        raise
    except Exception as error:  # the exceptions of tifffile have no common base class
        raise FormatError(f"is a TIFF that cannot be decoded ({error})") from error
    if values.ndim == 3 and values.shape[2] > 4:  # planes one after the other
        values = np.moveaxis(values, 0, 2)
    if (
        values.ndim not in (2, 3)
        or not np.isfinite(values).all()
        or values.min() < 0.0
        or values.max() > 255.0
    ):
        raise FormatError("has floating-point values that are not all from 0 to 1 or from 0 to 255")
    image = np.rint(values * (255.0 if values.max() <= 1.0 else 1.0)).astype(np.uint8)
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image[..., :3]
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY) if grey else colour, np.uint8)


def decode_stored(data: bytes, shrink: int = 1) -> Image:
    """Decode the bytes of a stored image to (H, W, 3) uint8 RGB. Raises `RecordingError` if damaged.

    shrink: see `decode_image`.
    """
    image = decode_image(data, shrink=shrink)
    if image is None:
        raise RecordingError("a stored image cannot be decoded; the recording is damaged")
    return image


def load_image(path: Path, grey: bool = False) -> Image | None:
    """Read an image file as `decode_image` does; None if it is missing, damaged or truncated."""
    try:
        return decode_image(read_bounded(path, MOST_BYTES), grey)
    except FormatError:
        return None


def read_image(path: Path, grey: bool = False) -> Image:
    """Read an image file as `load_image` does. Raises `InputError` naming it."""
    image = load_image(path, grey)
    if image is None:
        why = image_flaw(path) or "is not a complete picture"
        raise InputError(f"{path}: {why}: copy it again or leave it out")
    return image


def image_flaw(path: Path) -> str | None:
    """Return why an image file cannot be read or decoded; None if it can."""
    try:
        data = read_bounded(path, MOST_BYTES)
        flaw = picture_flaw(data)
        if flaw is None and holds_floats(data):
            _of_floats(data, grey=False)
        return flaw
    except FormatError as error:
        return str(error).removeprefix(f"{path}: ")


def require_same_aspect(where: str, drawn_on: tuple[float, float], shape: tuple[int, ...]) -> None:
    """Raise `InputError` if a label must be stretched to fit its image.

    where: name of the label. drawn_on: (width, height) of the picture it was drawn on. shape: (H, W, ...) of
    the image. Other sizes are accepted if width and height scale by the same factor, up to a pixel.
    """
    (width, height), (rows, columns, *_) = drawn_on, shape
    if abs(columns * height - rows * width) <= max(width, height, rows, columns):
        return
    turned = abs(rows * height - columns * width) <= max(width, height, rows, columns)
    cure = "it is turned by 90 degrees (an EXIF orientation?)" if turned else "it is of another picture"
    raise InputError(
        f"{where}: is {width:g} x {height:g} px, its image {columns} x {rows} px, upright: {cure}: draw it "
        "on the upright image, or leave it out"
    )


def require_single(path: Path) -> None:
    """Raise `InputError` for a file with several pictures, of which only one would be read.

    These are TIFF files with several pages, and animated PNG and WebP files, whatever their suffix.
    """
    try:
        several = (
            may_hold_several(read_beginning(path, BEGINNING_BYTES))
            and picture_count(read_bounded(path, MOST_BYTES)) > 1
        )
    except FormatError:
        return  # damaged: reported with the frame
    if several:
        raise InputError(f"{path}: {image_flaw(path)}")


def check_video_size(capture: cv2.VideoCapture, path: Path) -> None:
    """Raise `InputError` if the frames of a video exceed the pixel limit."""
    width, height = capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if width * height > MOST_PIXELS:
        raise InputError(f"{path}: is {width:.0f} x {height:.0f} px; at most {MOST_PIXELS:.2g} px are read")


def encode_jpeg(image: Image, quality: int = JPEG_QUALITY) -> bytes:
    """Encode (H, W, 3) uint8 RGB as JPEG. Raises `RecordingError`."""
    return _encode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])


def with_jpeg(frame: Frame) -> Frame:
    """Return a frame with its JPEG, so that the recording and the estimator use the same image.

    A frame without a JPEG is encoded once, and its image is replaced by the decoded JPEG. Raises
    `RecordingError`.
    """
    if frame.jpeg is not None:
        return frame
    jpeg = encode_jpeg(frame.image)
    return replace(frame, image=decode_stored(jpeg), jpeg=jpeg)


def encode_png(image: Image) -> bytes:
    """Encode (H, W, 3) uint8 RGB, or a mask (H, W) uint8, as PNG. Raises `RecordingError`."""
    return _encode(".png", image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [])


def _encode(suffix: str, image: MatLike, options: list[int]) -> bytes:
    failure = RecordingError(f"an image of shape {image.shape} cannot be encoded as {suffix[1:]}")
    try:
        done, data = cv2.imencode(suffix, image, options)
    except cv2.error as error:
        raise failure from error
    if not done:
        raise failure
    return data.tobytes()
