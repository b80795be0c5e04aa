"""The background of each sensor with a serial, stored when it is taken and offered at the next start."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

from drivers.errors import RecordingError
from drivers.images import encode_png, load_image
from drivers.types import Image
from rig.sessions.files import not_written, state_folder, write_file


@dataclass(frozen=True, slots=True, eq=False)
class StoredBackground:
    """A background, (H, W, 3) uint8 RGB, and the local time at which it was taken."""

    image: Image
    taken: datetime


def stored_background(serial: str) -> StoredBackground | None:
    """Return the stored background of a sensor; None without one, or if its file cannot be read."""
    file = _file(serial)
    image = load_image(file)
    return None if image is None else StoredBackground(image, datetime.fromtimestamp(file.stat().st_mtime))


def store_background(serial: str, image: Image) -> None:
    """Store the background of a sensor. Raises `RecordingError`."""
    file = _file(serial)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(file, error) from error
    write_file(file, encode_png(image))


def forget_background(serial: str) -> None:
    """Delete the stored background of a sensor. Raises `RecordingError`."""
    try:
        _file(serial).unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"{_file(serial)}: cannot be deleted ({error.strerror})") from error


def _file(serial: str) -> Path:
    return state_folder() / "backgrounds" / f"{quote(serial, safe='')}.png"
