"""Which sessions a folder holds, what came of them, and which are broken."""

import fcntl
import os
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from drivers.errors import InputError, SessionError
from rig.results.metrics import Mare
from rig.results.summary import mare_of
from rig.sessions.layout import LOCK, MANIFEST, RECORDINGS, RESULTS
from rig.sessions.manifest import (
    AnyManifest,
    BenchManifest,
    RecordManifest,
    TrialManifest,
    read_manifest,
)
from rig.sessions.records import REPLAYS, finished
from rig.sessions.rows import read_lifts, read_poses, read_rows

MCAP_END = b"\x89MCAP0\r\n"
"""The last bytes of a complete MCAP file (MCAP specification, "Magic")."""


class SessionState(StrEnum):
    """How far a session is."""

    COMPLETE = "complete"
    RUNNING = "running"
    UNFINISHED = "unfinished"
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class SessionEntry:
    """One session: what its manifest says, None where it cannot be read, and what is on disk.

    done: accepted lifts of a trial or poses of a recording. mare: over phases B and C, as the session's
    own estimator measured. problem: why it is broken.
    """

    folder: Path
    state: SessionState
    problem: str | None
    size_bytes: int
    manifest: AnyManifest | None
    done: int = 0
    mare: Mare | None = None

    @property
    def bench_manifest(self) -> TrialManifest | RecordManifest | None:
        """The manifest of a trial or recording; None for replays and where it cannot be read."""
        return self.manifest if isinstance(self.manifest, BenchManifest) else None

    @property
    def objects(self) -> tuple[str, ...]:
        """Ids of the objects asked for."""
        return self.bench_manifest.objects if self.bench_manifest else ()

    @property
    def wanted(self) -> int | None:
        """Lifts or poses asked for; None where that is not known beforehand."""
        return self.bench_manifest.wanted if self.bench_manifest else None


def find_sessions(folder: Path) -> list[Path]:
    """Return the session folders at or below a folder, by name. Raises `InputError` without such a folder.

    A folder with results or recordings but no manifest counts too: it is a broken session.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds the sessions")
    found = []
    for place, names, files in os.walk(folder):
        if MANIFEST in files or set(RESULTS.values()) & set(files) or Path(place, RECORDINGS).is_dir():
            found.append(Path(place))
            names.clear()
        names.sort()
    return sorted(found)


def holds_sessions(folder: Path) -> bool:
    """Whether a folder is no session itself, but has some below it."""
    return folder.is_dir() and find_sessions(folder) not in ([], [folder])


def list_session(folder: Path) -> SessionEntry:
    """Look at one session; whatever is wrong with it is in the entry."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    manifest: AnyManifest | None = None
    try:
        manifest = read_manifest(folder)
        return _entry(folder, size, manifest)
    except SessionError as error:
        return SessionEntry(folder, SessionState.BROKEN, str(error), size, manifest)


def _entry(folder: Path, size: int, manifest: AnyManifest) -> SessionEntry:
    found: Mare | None = None
    if isinstance(manifest, TrialManifest):
        lifts = finished(read_lifts(folder))
        done, found = len(lifts), mare_of(lift.re for lift in lifts)
        problems = [_recording_damage(folder / lift.recording) for lift in lifts]
    elif isinstance(manifest, RecordManifest):
        poses = [pose for pose in read_poses(folder) if pose.accepted]
        done, problems = len(poses), [_image_damage(folder / i.file) for pose in poses for i in pose.images]
    else:
        done = sum(row.accepted for row in read_rows(folder / RESULTS[manifest.kind], REPLAYS))
        problems = []
    problem = next(filter(None, problems), None)
    state = SessionState.COMPLETE if manifest.status == "complete" else SessionState.UNFINISHED
    if _in_use(folder):
        state = SessionState.RUNNING
    return SessionEntry(
        folder, SessionState.BROKEN if problem else state, problem, size, manifest, done, found
    )


def _image_damage(path: Path) -> str | None:
    return None if path.exists() else f"{path}: the image is missing"


def _recording_damage(path: Path) -> str | None:
    if not path.exists():
        return f"{path}: the recording is missing"
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - len(MCAP_END)))
        return None if stream.read() == MCAP_END else f"{path}: the recording is cut short"


def _in_use(folder: Path) -> bool:
    """Whether a process holds the session's lock; a lock left behind holds nothing."""
    try:
        handle = os.open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False
