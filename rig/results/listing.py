"""Which sessions a folder holds, what came of them, and which are broken."""

import fcntl
import os
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivers.errors import InputError, SessionError
from rig.results.metrics import Mare, mare
from rig.sessions.files import read_lines
from rig.sessions.layout import MANIFEST, RESULTS
from rig.sessions.session import read_manifest

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
    """One session: what its manifest says, and what is on disk.

    done, wanted: accepted lifts of a trial or poses of a recording. mare: over phases B and C,
    as the session's own estimator measured. problem: why it is broken.
    """

    folder: Path
    state: SessionState
    problem: str | None
    size_bytes: int
    manifest: dict[str, Any]
    done: int = 0
    mare: Mare | None = None

    @property
    def kind(self) -> str:
        """Return "trial", "record" or "replay"; empty where the manifest cannot be read."""
        return str(self.manifest.get("kind", ""))

    @property
    def objects(self) -> list[str]:
        """Ids of the objects asked for."""
        return list(self.manifest.get("objects", []))

    @property
    def wanted(self) -> int | None:
        """Lifts or poses asked for; None where that is not known beforehand."""
        if self.kind == "trial":
            return len(self.objects) * int(self.manifest.get("lifts_per_object", 0))
        return self.manifest.get("poses")


def find_sessions(folder: Path) -> list[Path]:
    """Return the session folders at or below a folder, by name. Raises `InputError` without such a folder.

    A folder with results or recordings but no manifest counts too: it is a broken session.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds the sessions")
    found = []
    for place, names, files in os.walk(folder):
        if MANIFEST in files or set(RESULTS.values()) & set(files) or Path(place, "lifts").is_dir():
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
    manifest: dict[str, Any] = {}
    try:
        manifest = read_manifest(folder)
        rows = read_lines(folder / RESULTS.get(str(manifest.get("kind")), ""))
        return _entry(folder, size, manifest, [row for row in rows if row.get("accepted")])
    except SessionError as error:
        return SessionEntry(folder, SessionState.BROKEN, str(error), size, manifest)
    except (KeyError, TypeError, AttributeError, IsADirectoryError) as error:
        problem = f"{folder}: not what a session of this version holds ({error!r})"
        return SessionEntry(folder, SessionState.BROKEN, problem, size, manifest)


def _entry(folder: Path, size: int, manifest: dict[str, Any], rows: list[dict[str, Any]]) -> SessionEntry:
    problem = next(filter(None, (_damage(folder, row) for row in rows)), None)
    errors = [row["re"] for row in rows if row.get("re")]
    found = mare([e["mean_deg"] for e in errors], [e["std_deg"] for e in errors])
    state = SessionState.COMPLETE if manifest["status"] == "complete" else SessionState.UNFINISHED
    if _in_use(folder):
        state = SessionState.RUNNING
    return SessionEntry(
        folder, SessionState.BROKEN if problem else state, problem, size, manifest, len(rows), found
    )


def _damage(folder: Path, row: dict[str, Any]) -> str | None:
    """Say which file of a finished piece of work is missing or cut short."""
    if "recording" not in row:
        files = [folder / image["file"] for image in row.get("images", [])]
        missing = next((file for file in files if not file.exists()), None)
        return f"{missing}: the image is missing" if missing else None
    path = folder / row["recording"]
    if not path.exists():
        return f"{path}: the recording is missing"
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - len(MCAP_END)))
        return None if stream.read() == MCAP_END else f"{path}: the recording is cut short"


def _in_use(folder: Path) -> bool:
    """Whether a process holds the session's lock; a lock left behind holds nothing."""
    try:
        handle = os.open(folder / ".lock", os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False
