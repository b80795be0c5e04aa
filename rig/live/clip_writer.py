"""Write a clip of one sensor as its frames arrive: frames, their times, metadata, and the background."""

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import RecordingError
from drivers.images import encode_png
from drivers.types import Frame, Image
from rig.frames.clips import ABOUT, BACKGROUND, FRAMES, TIMES
from rig.sessions.files import write_json


class ClipWriter:
    """A clip in the layout that `rig label-angle`, `rig estimate` and `rig benchmark clips` read.

    folder: of the clip; it is created. background: the frame without contact. about: metadata, JSON values.
    Raises `RecordingError` if a file cannot be written.
    """

    def __init__(self, folder: Path, background: Image, about: Mapping[str, object]) -> None:
        self.folder, self.count = folder, 0
        self._first_ns = 0
        try:
            (folder / FRAMES).mkdir(parents=True)
            (folder / f"{BACKGROUND}.png").write_bytes(encode_png(background))
            write_json(folder / ABOUT, dict(about))
            self._times = (folder / TIMES).open("w", encoding="utf-8")
            self._times.write("frame,t_s\n")
        except OSError as error:
            raise self._failed(error) from error

    def add(self, frame: Frame) -> None:
        """Write a frame: its JPEG as received, or a PNG if the source sends no JPEG."""
        name = f"{self.count:06d}.{'png' if frame.jpeg is None else 'jpg'}"
        self._first_ns = frame.time_ns if self.count == 0 else self._first_ns
        try:
            (self.folder / FRAMES / name).write_bytes(frame.jpeg or encode_png(frame.image))
            self._times.write(f"{name},{(frame.time_ns - self._first_ns) / NS_PER_S:.9f}\n")
        except OSError as error:
            raise self._failed(error) from error
        self.count += 1

    def close(self) -> None:
        """Complete the table of times."""
        self._times.close()

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{error.filename or self.folder}: the clip cannot be written ({error.strerror})"
        )


def clip_folder(clips: Path, serial: str) -> Path:
    """Return the folder of a new clip, named by date, time and sensor."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in serial)
    return clips / f"{datetime.now():%Y-%m-%dT%H%M%S}_{name}"
