"""Write a clip of one sensor as its frames arrive: frames, their times, metadata, and the background.

Each frame on disk is complete and has its time, however the program ends: its row is written before it, and
it gets its name when it is complete.
"""

import errno
import os
from collections.abc import Mapping
from contextlib import suppress
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
            self._times = (folder / TIMES).open("wb", buffering=0)
            self._append("frame,t_s")
        except OSError as error:
            raise self._failed(error) from error

    def add(self, frame: Frame) -> None:
        """Write a frame: its JPEG as received, or a PNG if the source sends none. Raises `RecordingError`."""
        name = f"{self.count:06d}.{'png' if frame.jpeg is None else 'jpg'}"
        self._first_ns = frame.time_ns if self.count == 0 else self._first_ns
        begun = self.folder / FRAMES / f".{name}"
        try:
            self._append(f"{name},{(frame.time_ns - self._first_ns) / NS_PER_S:.9f}")
            begun.write_bytes(frame.jpeg or encode_png(frame.image))
            begun.rename(begun.with_name(name))
        except OSError as error:
            with suppress(OSError):
                begun.unlink(missing_ok=True)
            raise self._failed(error) from error
        self.count += 1

    def close(self) -> None:
        """Close the table of times, which is complete at any time."""
        self._times.close()

    def _append(self, row: str) -> None:
        """Write a row of the table with one system call; remove it if the disk has space for a part only."""
        line, end = f"{row}\n".encode(), os.fstat(self._times.fileno()).st_size
        if self._times.write(line) != len(line):
            self._times.truncate(end)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), self._times.name)

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{error.filename or self.folder}: the clip cannot be written ({error.strerror})"
        )


def clip_folder(clips: Path, serial: str) -> Path:
    """Return the folder of a new clip, named by date, time and sensor."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in serial)
    return clips / f"{datetime.now():%Y-%m-%dT%H%M%S}_{name}"
