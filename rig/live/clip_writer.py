"""Write clips of sensors: frames, their times, metadata, the background, and marks of the user.

Each frame on disk is complete and has its time, however the program ends: its row is written before it, and
it gets its name when it is complete.
"""

import errno
import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from datetime import datetime
from io import FileIO
from itertools import count
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import InputError, RecordingError, plural
from drivers.images import encode_png
from drivers.realtime import ordinary
from drivers.types import Frame, Image
from rig.frames.clips import ABOUT, BACKGROUND, FRAMES, TIMES
from rig.frames.times import spacing_notes
from rig.live.feed import RECORD, SAVE
from rig.live.sensor_background import SensorBackground
from rig.sessions.files import write_json
from rig.version import version_text

MARKS = "marks.csv"
"""Marks of the user in a clip: time since its first frame in s, and text."""
SAVED_S, MOST_SAVED_BYTES = 30.0, 256_000_000
"""Length of the newest frames that can be saved, and their most bytes per sensor: 30 s of a DIGIT's JPEG take
about 30 MB, those of a GelSight Mini, which are not encoded (320 x 240 px, 25 Hz), 173 MB."""
NO_IMAGE: Image = np.empty((0, 0, 3), np.uint8)
KEPT_MARKS = 300
SAVE_PAUSE_S, SAVE_PAUSES, LATE_S = 0.003, 20, 0.05
"""Pause after each frame that is saved; it is repeated at most so often while estimates are later than
`LATE_S`. Without pauses, saving 30 s of two simulated sensors on a loaded host dropped 57 frames."""


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
        self.folder = folder
        self.times_ns = list[int]()
        try:
            (folder / FRAMES).mkdir(parents=True)
            (folder / f"{BACKGROUND}.png").write_bytes(encode_png(background))
            write_json(folder / ABOUT, {**about, "tool_version": version_text()})
            self._times = (folder / TIMES).open("wb", buffering=0)
            _append(self._times, "frame,t_s")
        except OSError as error:
            raise self._error(error) from error

    def add(self, frame: Frame) -> None:
        """Write a frame: its JPEG as received, or a PNG if the source sends none. Raises `RecordingError`."""
        name = f"{len(self.times_ns):06d}.{'png' if frame.jpeg is None else 'jpg'}"
        first_ns = self.times_ns[0] if self.times_ns else frame.time_ns
        begun = self.folder / FRAMES / f".{name}"
        try:
            _append(self._times, f"{name},{(frame.time_ns - first_ns) / NS_PER_S:.9f}")
            begun.write_bytes(frame.jpeg or encode_png(frame.image))
            begun.rename(begun.with_name(name))
        except OSError as error:
            with suppress(OSError):
                begun.unlink(missing_ok=True)
            raise self._error(error) from error
        self.times_ns.append(frame.time_ns)

    def mark(self, time_ns: int, text: str) -> None:
        """Write a mark into `MARKS` unless its time is before the clip. Raises `RecordingError`."""
        if not self.times_ns or time_ns < self.times_ns[0]:
            return
        file = self.folder / MARKS
        head = "" if file.exists() else "time_s,text\n"
        try:
            with file.open("ab", buffering=0) as table:
                _append(table, f"{head}{(time_ns - self.times_ns[0]) / NS_PER_S:.9f},{text}")
        except OSError as error:
            raise self._error(error) from error

    @property
    def summary(self) -> str:
        """Folder, number of frames, duration, and gaps, such as those of dropped frames."""
        times = self.times_ns
        span_s = (times[-1] - times[0]) / NS_PER_S if times else 0.0
        frames = f"{self.folder}: {plural(len(times), 'frame')}, {span_s:.1f} s"
        return "; ".join([frames, *spacing_notes(times)])

    def close(self) -> None:
        """Close the table of times, which is complete at any time."""
        self._times.close()

    def _error(self, error: OSError) -> RecordingError:
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


class Clips:
    """The clips of the sensors on a desk: recorded from a moment on, or saved from the newest frames.

    folder: in which clips are created. backgrounds: of the sensors, by name. simulated: whether a sensor is
    simulated. keeps_frames: whether the newest frames are kept in memory, to save them.
    """

    def __init__(
        self, folder: Path, backgrounds: Mapping[str, SensorBackground], simulated: bool, keeps_frames: bool
    ) -> None:
        self._folder, self._backgrounds, self._simulated = folder, backgrounds, simulated
        self._keeps_frames, self._newest = keeps_frames, {name: NewestFrames() for name in backgrounds}
        self._writers: dict[str, ClipWriter] = {}
        self._marks: deque[tuple[int, str]] = deque(maxlen=KEPT_MARKS)
        self._saving: threading.Thread | None = None
        self._saved = queue.SimpleQueue[str]()
        self._closing = threading.Event()
        self._late_s = 0.0

    @property
    def is_recording(self) -> bool:
        return bool(self._writers)

    def begin(self) -> str:
        """Begin a clip of each sensor; return a text that names them.

        Raises `InputError` while a background is taken, `RecordingError` if a clip cannot be written; then
        none is recorded.
        """
        makers = {name: self._maker(name, RECORD) for name in self._backgrounds}
        try:
            for name, make in makers.items():
                self._writers[name] = make()
        except RecordingError:
            self.end()
            raise
        return f"recording to {', '.join(str(writer.folder) for writer in self._writers.values())}"

    def end(self) -> str:
        """End the clips that are recorded; return a text that names them."""
        done = []
        for writer in self._writers.values():
            writer.close()
            done.append(writer.summary)
        self._writers = {}
        return f"recorded {'; '.join(done)}"

    def add(self, name: str, frame: Frame, late_s: float) -> None:
        """Add a frame of a sensor. late_s: time from its capture to the angle.

        Raises `RecordingError` if it cannot be recorded; all clips have ended then.
        """
        self._late_s = late_s
        if self._keeps_frames:
            self._newest[name].add(frame)
        if name in self._writers:
            self._write(lambda: self._writers[name].add(frame))

    def mark(self, time_ns: int, text: str) -> None:
        """Add a mark to the clips that are recorded, or saved later. Raises `RecordingError` as `add`."""
        self._marks.append((time_ns, text))
        for writer in self._writers.values():
            self._write(lambda writer=writer: writer.mark(time_ns, text))

    def save_last(self) -> str:
        """Write the newest frames of each sensor into a clip, in a thread that delays no estimate.

        `take_saved` returns the result. Raises `InputError` if the clips before are still being written, or
        while a background is taken.
        """
        if self._saving is not None and self._saving.is_alive():
            raise InputError("save: wait until the clip before is saved")
        # frames of a sensor that is unplugged may be older than those of the other one
        newest_ns = max((n.frames[-1].time_ns for n in self._newest.values() if n.frames), default=0)
        since_ns = newest_ns - to_ns(SAVED_S)
        clips = [(self._maker(name, SAVE), of.since(since_ns)) for name, of in self._newest.items()]
        self._saving = threading.Thread(target=self._save, args=(clips, list(self._marks)))
        self._saving.start()
        return f"saving the last {SAVED_S:.0f} s"

    def take_saved(self) -> str | None:
        """Return which clips were saved since the last call, or why they were not; None without any."""
        with suppress(queue.Empty):
            return self._saved.get_nowait()
        return None

    def close(self) -> None:
        """End the clips that are recorded, and wait for those that are being saved."""
        self._closing.set()
        self.end()
        if self._saving is not None:
            self._saving.join()

    def _maker(self, name: str, action: str) -> Callable[[], ClipWriter]:
        """Return a function that creates a clip of a sensor. Raises `InputError` without a background."""
        background = self._backgrounds[name]
        image = background.image
        if image is None:
            raise InputError(f"{action}: wait until the background is taken")
        about = {"sensor": name, "simulated": self._simulated, "background": background.origin}
        return lambda: ClipWriter(clip_folder(self._folder, name), image, about)

    def _write(self, write: Callable[[], None]) -> None:
        try:
            write()
        except RecordingError as error:
            raise RecordingError(f"{error}; {self.end()}") from error

    def _save(
        self, clips: list[tuple[Callable[[], ClipWriter], list[Frame]]], marks: list[tuple[int, str]]
    ) -> None:
        """Write clips and put their names, or an error, into the queue; runs in a separate thread."""
        done = list[str]()
        try:
            with ordinary():
                for make, frames in clips:
                    with closing(make()) as clip:
                        for frame in frames:
                            clip.add(frame)
                            self._pause()
                        for mark in marks:
                            clip.mark(*mark)
                    done.append(f"saved {clip.summary}")
        except RecordingError as error:
            done.append(str(error))
        self._saved.put("; ".join(done))

    def _pause(self) -> None:
        for _ in range(SAVE_PAUSES):
            self._closing.wait(SAVE_PAUSE_S)
            if self._late_s < LATE_S:
                return
