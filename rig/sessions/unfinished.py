"""Recordings of lifts in progress, written by a background thread, and of interrupted lifts.

A lift is recorded under an unfinished name, in the process that executes it. The process that writes the
results gives the recording its final name before it appends the lift's line. So a recording with an
unfinished name never counts as a lift. If the program is killed, it keeps that name until the session is
resumed.
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread

from drivers.errors import RecordingError
from rig.sessions.files import INTERRUPTED, RECORDINGS, UNFINISHED, not_written
from rig.sessions.recorder import LiftRecorder

MOST_WAITING = 64_000_000
"""Most bytes that may wait for the disk: about 20 s of a lift at 3 MB/s. A longer stall of the disk is a
fault."""


class BackgroundFile:
    """A new file for binary data. `write` neither copies nor waits; `close` waits for the disk.

    names: paths in order of preference. The first that does not exist is created at the first write, so an
    existing file is never overwritten, and a file to which nothing is written is never created.
    """

    def __init__(self, names: Iterable[Path]) -> None:
        self._names = iter(names)
        self._path = next(self._names)
        self._queue: SimpleQueue[bytes | None] = SimpleQueue()
        self._lock = Lock()
        self._waiting = 0
        self._size = 0
        self._failure: OSError | None = None
        self._thread: Thread | None = None

    @property
    def path(self) -> Path:
        return self._path

    def write(self, data: bytes) -> int:
        """Queue data and return their size.

        Raises `RecordingError` if the file cannot be created, if an earlier write failed, as on a full disk,
        or if the disk is slower than the data for longer than the queue lasts.
        """
        if self._thread is None:
            self._thread = self._start()
        self._raise_failure()
        with self._lock:
            self._waiting += len(data)
        if self._waiting > MOST_WAITING:
            raise RecordingError(
                f"{self._path}: the disk is too slow: {self._waiting / 1e6:.0f} MB wait to be written; "
                "use a faster disk, or end other programs that write, then continue with --resume"
            )
        self._queue.put(data)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        return self._size

    def close(self) -> None:
        """Wait until all data are on the disk. Safe to call twice. Raises `RecordingError` if that fails."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
        self._raise_failure()

    def _start(self) -> Thread:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            handle = -1
            while handle < 0:
                try:
                    handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
                except FileExistsError:
                    self._path = next(self._names)
        except OSError as error:
            raise not_written(self._path, error) from error
        thread = Thread(
            target=self._write_all, args=(handle,), name=f"writer of {self._path.name}", daemon=True
        )
        thread.start()
        return thread

    def _write_all(self, handle: int) -> None:
        """Write queued data until `close`; after a failure write nothing more."""
        try:
            while (data := self._queue.get()) is not None:
                left = memoryview(data)
                while left:
                    left = left[os.write(handle, left) :]
                with self._lock:
                    self._waiting -= len(data)
            os.fsync(handle)
        except OSError as error:
            self._failure = error
        finally:
            os.close(handle)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise not_written(self._path, self._failure) from self._failure


def new_recording(folder: Path, recording: str) -> BackgroundFile:
    """Return the file in which a lift is recorded, under an unused unfinished name.

    folder: of the session. recording: final name in it, as `rig.sessions.files.recording_file` gives it.
    """
    final = folder / recording
    ends = (UNFINISHED if number == 1 else f"{UNFINISHED}-{number}" for number in count(1))
    return BackgroundFile(final.with_name(f"{final.stem}{end}.mcap") for end in ends)


@contextmanager
def complete_at_end(recorder: LiftRecorder, file: BackgroundFile) -> Iterator[None]:
    """Complete a recording when the lift ends; if an error ends it, keep the data recorded until then.

    Raises `RecordingError` if the recording cannot be written, unless another error is being raised.
    """
    try:
        yield
    except BaseException:
        with suppress(RecordingError):
            if recorder.begun:
                _complete(recorder, file)
        raise
    _complete(recorder, file)


def _complete(recorder: LiftRecorder, file: BackgroundFile) -> None:
    with closing(file):
        recorder.close()


def set_aside(recording: Path) -> None:
    """Rename a recording without a line in the results to an unused interrupted name. Raises `OSError`."""
    stem = recording.stem.partition(UNFINISHED)[0]
    names = (recording.with_name(f"{stem}{INTERRUPTED}-{number}.mcap") for number in count(1))
    recording.rename(next(name for name in names if not name.exists()))


def name_interrupted(folder: Path) -> None:
    """Rename the unfinished recordings of a session that is resumed: 007.unfinished to 007.interrupted-1.

    No lift is in progress then, so "unfinished" names only lifts that may be in progress. Raises
    `RecordingError`.
    """
    for path in sorted((folder / RECORDINGS).glob(f"*{UNFINISHED}*.mcap")):
        try:
            set_aside(path)
        except OSError as error:
            raise not_written(path, error) from error
