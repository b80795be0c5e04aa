"""One encoding per image: what is stored is what the estimator sees."""

import cv2
import numpy as np

from drivers.errors import RecordingError
from drivers.types import Frame, Image

JPEG_QUALITY = 95


def stored(frame: Frame) -> tuple[Frame, bytes]:
    """Return the frame as its stored bytes decode, and those bytes.

    A source that delivers JPEG keeps its own bytes; any other image is encoded here, once,
    and replaced by what the encoding made of it.
    """
    if frame.jpeg is not None:
        return frame, frame.jpeg
    encoded = jpeg(frame.image, JPEG_QUALITY, f"{frame.serial}: frame {frame.sequence}")
    return Frame(decoded(encoded), frame.time_ns, frame.sequence, frame.serial, encoded), encoded


def jpeg(image: Image, quality: int, what: str = "an image") -> bytes:
    """Encode (H, W, 3) uint8 RGB as JPEG. what: named in the error. Raises `RecordingError`."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    ok, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise RecordingError(f"{what} could not be encoded as JPEG")
    return encoded.tobytes()


def decoded(encoded: bytes) -> Image:
    """Decode stored bytes to (H, W, 3) uint8 RGB. Raises `RecordingError` when damaged."""
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise RecordingError("a stored image cannot be decoded; the recording is damaged")
    return np.asarray(image, np.uint8)


def png(image: Image) -> bytes:
    """Encode (H, W, 3) uint8 RGB, or a mask (H, W) uint8, as PNG. Raises `RecordingError`."""
    ok, encoded = cv2.imencode(".png", image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not ok:
        raise RecordingError("an image could not be encoded as PNG")
    return encoded.tobytes()
