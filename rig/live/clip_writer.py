"""Write a clip of one sensor: frames, their times, metadata, the background, and marks of the user.

Each frame on disk is complete and has its time, however the program ends: its row is written before it, and
it gets its name when it is complete.
"""

import errno
import os
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from io import FileIO
from itertools import count
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import RecordingError
from drivers.images import encode_png
from drivers.types import Frame, Image
from rig.frames.clips import ABOUT, BACKGROUND, FRAMES, TIMES
from rig.sessions.files import write_json
from rig.version import VERSION

MARKS = "marks.csv"
"""Marks of the user in a clip: time since its first frame in s, and text."""
SAVED_S, MOST_SAVED_BYTES = 30.0, 256_000_000
"""Length of the newest frames that can be saved, and their most bytes per sensor: 30 s of a DIGIT's JPEG take
about 30 MB, those of a GelSight Mini, which are not encoded (320 x 240 px, 25 Hz), 173 MB."""
NO_IMAGE: Image = np.empty((0, 0, 3), np.uint8)


class NewestFrames:
    """The frames of the last `SAVED_S` in memory, as the sensor sent them: nothing is encoded per frame."""

    def __init__(self) -> None:
        self.frames: deque[Frame] = deque()
        self._bytes = 0

    def add(self, frame: Frame) -> None:
        """Keep a frame; a decoded image is not kept beside its JPEG."""
        kept = frame if frame.jpeg is None else replace(frame, image=NO_IMAGE)
        self.frames.append(kept)
        self._bytes += _size(kept)
        oldest_ns = frame.time_ns - to_ns(SAVED_S)
        while self.frames[0].time_ns < oldest_ns or self._bytes > MOST_SAVED_BYTES:
            self._bytes -= _size(self.frames.popleft())

    def since(self, time_ns: int) -> list[Frame]:
        """Return the frames that were captured at or after a time."""
        return [frame for frame in self.frames if frame.time_ns >= time_ns]


def _size(frame: Frame) -> int:
    return frame.image.nbytes + len(frame.jpeg or b"")


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
            write_json(folder / ABOUT, {**about, "tool_version": VERSION})
            self._times = (folder / TIMES).open("wb", buffering=0)
            _append(self._times, "frame,t_s")
        except OSError as error:
            raise self._failed(error) from error

    def add(self, frame: Frame) -> None:
        """Write a frame: its JPEG as received, or a PNG if the source sends none. Raises `RecordingError`."""
        name = f"{self.count:06d}.{'png' if frame.jpeg is None else 'jpg'}"
        self._first_ns = frame.time_ns if self.count == 0 else self._first_ns
        begun = self.folder / FRAMES / f".{name}"
        try:
            _append(self._times, f"{name},{(frame.time_ns - self._first_ns) / NS_PER_S:.9f}")
            begun.write_bytes(frame.jpeg or encode_png(frame.image))
            begun.rename(begun.with_name(name))
        except OSError as error:
            with suppress(OSError):
                begun.unlink(missing_ok=True)
            raise self._failed(error) from error
        self.count += 1

    def mark(self, time_ns: int, text: str) -> None:
        """Write a mark into `MARKS` unless its time is before the clip. Raises `RecordingError`."""
        if self.count == 0 or time_ns < self._first_ns:
            return
        file = self.folder / MARKS
        head = "" if file.exists() else "time_s,text\n"
        try:
            with file.open("ab", buffering=0) as table:
                _append(table, f"{head}{(time_ns - self._first_ns) / NS_PER_S:.9f},{text}")
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Close the table of times, which is complete at any time."""
        self._times.close()

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{error.filename or self.folder}: the clip cannot be written ({error.strerror})"
        )


def _append(table: FileIO, row: str) -> None:
    """Write a row of a table with one system call; remove it if the disk has space for a part only."""
    line, end = f"{row}\n".encode(), os.fstat(table.fileno()).st_size
    if table.write(line) != len(line):
        table.truncate(end)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), table.name)


def clip_folder(clips: Path, serial: str) -> Path:
    """Return the folder of a new clip, named by date, time and sensor; it does not exist yet.

    serial: a long address is cut off, because the names of folders have at most 255 bytes.
    """
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in serial[:50])
    folder = clips / f"{datetime.now():%Y-%m-%dT%H%M%S}_{name}"
    names = (folder.with_name(f"{folder.name}_{number}") for number in count(2))
    return folder if not folder.exists() else next(each for each in names if not each.exists())
