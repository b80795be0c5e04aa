"""Which sessions a folder holds, what came of them, and which are broken."""

import os
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from drivers.errors import InputError, SessionError
from drivers.images import image_flaw
from rig.results.metrics import Mare
from rig.results.summary import mare_of
from rig.sessions.layout import MANIFEST, RECORDINGS, RESULTS
from rig.sessions.manifest import (
    AnyManifest,
    BenchManifest,
    RecordManifest,
    TrialManifest,
    read_manifest,
)
from rig.sessions.recording_file import check_recording
from rig.sessions.records import LIFTS, REPLAYS, finished
from rig.sessions.rows import read_poses, read_rows, readable_rows
from rig.sessions.session import in_use


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


def list_session(folder: Path, quick: bool = False) -> SessionEntry:
    """Look at one session, every byte of its recordings; whatever is wrong with it is in the entry.

    quick: see whether its recordings and images are there, no more.
    """
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    manifest: AnyManifest | None = None
    try:
        manifest = read_manifest(folder)
        return _entry(folder, size, manifest, quick)
    except InputError as error:
        return SessionEntry(folder, SessionState.BROKEN, str(error), size, manifest)


def _entry(folder: Path, size: int, manifest: AnyManifest, quick: bool) -> SessionEntry:
    found: Mare | None = None
    if isinstance(manifest, TrialManifest):
        path = folder / RESULTS[manifest.kind]
        rows, damaged = readable_rows(path, LIFTS)
        lifts = finished(rows)
        done, found = len(lifts), mare_of(lift.re for lift in lifts)
        problems = [line.text(path) for line in damaged]
        problems += [_recording_damage(folder / lift.recording, quick) for lift in lifts]
    elif isinstance(manifest, RecordManifest):
        poses = [pose for pose in read_poses(folder) if pose.accepted]
        done = len(poses)
        problems = [_image_damage(folder / i.file, quick) for pose in poses for i in pose.images]
    else:
        done = sum(row.accepted for row in read_rows(folder / RESULTS[manifest.kind], REPLAYS))
        problems = []
    problem = _first(list(filter(None, problems)))
    state = SessionState.COMPLETE if manifest.status == "complete" else SessionState.UNFINISHED
    if in_use(folder):
        state = SessionState.RUNNING
    return SessionEntry(
        folder, SessionState.BROKEN if problem else state, problem, size, manifest, done, found
    )


def _first(problems: list[str]) -> str | None:
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{problems[0]}{more}" if problems else None


def _image_damage(path: Path, quick: bool) -> str | None:
    if not path.exists():
        return f"{path}: the image is missing"
    flaw = None if quick else image_flaw(path)
    return None if flaw is None else f"{path}: the image {flaw}"


def _recording_damage(path: Path, quick: bool) -> str | None:
    if not path.exists():
        return f"{path}: the recording is missing"
    try:
        if not quick:
            check_recording(path)
    except SessionError as error:
        return str(error)
    return None
