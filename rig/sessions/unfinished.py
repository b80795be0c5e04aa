"""Recordings of lifts under way, and those that an interrupted lift leaves behind.

A lift is recorded under an unfinished name, in whichever process carries it out. The process that writes the
results gives the recording its final name before the lift's line is appended. So a recording under an
unfinished name never counts as a lift, and it keeps its name when the program is killed.
"""

from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path

from drivers.errors import RecordingError
from rig.sessions.background_file import BackgroundFile
from rig.sessions.layout import RECORDINGS, is_unfinished, unfinished_name
from rig.sessions.recorder import LiftRecorder


def unfinished_names(recording: Path) -> Iterator[Path]:
    """Yield the unfinished names of a recording in order of preference. recording: its final path."""
    return (recording.with_name(unfinished_name(recording.stem, number)) for number in count(1))


def new_recording(folder: Path, recording: str) -> BackgroundFile:
    """Return the file in which a lift is recorded, under an unfinished name that is still free.

    folder: of the session. recording: final name in it, as `rig.sessions.layout.recording_file` gives it.
    """
    return BackgroundFile(unfinished_names(folder / recording))


@contextmanager
def completed(recorder: LiftRecorder, file: BackgroundFile) -> Iterator[None]:
    """Complete a recording when the lift ends; if an error ends it, keep what was recorded until then.

    Raises `RecordingError` if the recording cannot be written, except beside another error.
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
    """Rename a recording without a line in the results to an unfinished name that is still free."""
    for name in unfinished_names(recording):
        if not name.exists():
            recording.rename(name)
            return


def unfinished_recordings(folder: Path) -> list[Path]:
    """Return the unfinished recordings of a session, by name."""
    return sorted(path for path in (folder / RECORDINGS).glob("*.mcap") if is_unfinished(path))
