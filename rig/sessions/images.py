"""One encoding per image: what is stored is what the estimator sees."""

from drivers.errors import RecordingError
from drivers.images import decode_image, encode_jpeg
from drivers.types import Frame, Image


def stored(frame: Frame) -> tuple[Frame, bytes]:
    """Return the frame as its stored bytes decode, and those bytes.

    A source that delivers JPEG keeps its own bytes; any other image is encoded here, once,
    and replaced by what the encoding made of it.
    """
    if frame.jpeg is not None:
        return frame, frame.jpeg
    encoded = encode_jpeg(frame.image)
    return Frame(decoded(encoded), frame.time_ns, frame.sequence, frame.serial, encoded), encoded


def decoded(encoded: bytes) -> Image:
    """Decode stored bytes to (H, W, 3) uint8 RGB. Raises `RecordingError` when damaged."""
    image = decode_image(encoded)
    if image is None:
        raise RecordingError("a stored image cannot be decoded; the recording is damaged")
    return image
