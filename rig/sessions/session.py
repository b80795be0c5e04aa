"""The session folder: manifest, results stored as they arrive, and resuming after any interruption."""

import fcntl
import logging
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from drivers.errors import InputError, RecordingError
from rig.config.measured_values import Calibrations
from rig.sessions.codec import Codec, json_line, json_value
from rig.sessions.files import (
    CALIBRATIONS,
    LOCK,
    LOG,
    MANIFEST,
    RESULTS,
    TIMING,
    append_line,
    drop_torn_line,
    not_written,
    write_file,
    write_json,
)
from rig.sessions.manifest import BenchManifest, Manifest, first_difference, now_text, read_manifest
from rig.sessions.records import TimingLine
from rig.sessions.rows import read_rows
from rig.sessions.unfinished import name_interrupted, set_aside

Row = TypeVar("Row")
BEGINNING = MANIFEST + ".part"
"""A manifest that is not complete: its session was killed when it began."""
SESSIONS = Path("sessions")
"""Default folder of new sessions."""


class SessionLog(logging.FileHandler):
    """A log whose failure, as on a full disk, is reported once and interrupts nothing."""

    _lost = False

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the library's name
        """Report once that the log cannot be written."""
        if not self._lost:
            self._lost = True
            text = f"{self.baseFilename}: cannot be written ({sys.exc_info()[1]}); the log ends here"
            with suppress(OSError, ValueError):
                print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Close the file even if the rest cannot be written."""
        with suppress(OSError):
            super().close()


class Session(Generic[Row]):
    """A folder written by one process; every finished lift or pose is stored on disk immediately.

    Layout (contract): `session.json` manifest, `RESULTS` one line per finished lift or pose, `timing.jsonl`
    all measured durations, `log.txt`.
    """

    def __init__(self, folder: Path, manifest: Manifest, codec: Codec[Row], begun_here: bool = False) -> None:
        """begun_here: whether this process created the folder and may remove it if it stays empty."""
        self.folder = folder
        self._begun_here = begun_here
        self.manifest = manifest
        self._results = folder / RESULTS[manifest.kind]
        self._lock = _lock_folder(folder)
        drop_torn_line(self._results)
        drop_torn_line(folder / TIMING)
        name_interrupted(folder)
        self.rows = read_rows(self._results, codec)
        self._log = SessionLog(folder / LOG)
        self._log.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        logger = logging.getLogger("rig")
        logger.setLevel(logging.INFO)
        logger.addHandler(self._log)

    @property
    def complete(self) -> bool:
        return self.manifest.status == "complete"

    def keep(self) -> None:
        """Keep the folder even if the session ends before its first result, because work begins now."""
        self._begun_here = False

    def add(self, row: Row, timing: TimingLine) -> None:
        """Store the result of one lift or pose. Raises `RecordingError`."""
        append_line(self._results, json_line(row))
        append_line(self.folder / TIMING, json_line(timing))
        self.rows.append(row)

    def write(self, name: str, data: bytes) -> None:
        """Store a file in the session. Raises `RecordingError`."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)

    def adopt(self, name: str, path: Path) -> None:
        """Rename a file of the session to its final name. Raises `RecordingError`.

        An existing file of that name belongs to an attempt without a result: it is renamed, not overwritten.
        """
        final = self.folder / name
        try:
            if final.exists():
                set_aside(final)
            path.rename(final)
        except OSError as error:
            raise not_written(final, error) from error

    def finish(self, order: Callable[[Row], Any]) -> None:
        """Sort the results (parallel lifts finish in any order) and mark the session complete."""
        self.rows.sort(key=order)
        write_file(self._results, b"".join(map(json_line, self.rows)))
        self.manifest = replace(self.manifest, status="complete", completed=now_text())
        write_json(self.folder / MANIFEST, json_value(self.manifest))

    def close(self) -> None:
        """Release the folder for other processes. Safe to call twice."""
        logging.getLogger("rig").removeHandler(self._log)
        self._log.close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> "Session[Row]":
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        self.close()
        if error is None or not self._begun_here or self.rows:
            return
        files = list(self.folder.iterdir())
        if {path.name for path in files} <= {MANIFEST, LOCK, LOG, CALIBRATIONS}:
            shutil.rmtree(self.folder / CALIBRATIONS, ignore_errors=True)
            for path in files:
                path.unlink(missing_ok=True)
            with suppress(OSError):  # the current folder of another process cannot be removed
                self.folder.rmdir()


def default_folder(kind: str, object_id: str | None = None) -> Path:
    """Return `sessions/<date>_<object>_<kind>`, sortable by name."""
    stamp = datetime.now(UTC).astimezone().strftime("%Y-%m-%dT%H%M%S")
    middle = f"_obj{object_id}" if object_id else ""
    return SESSIONS / f"{stamp}{middle}_{kind}"


def open_session(folder: Path, wanted: Manifest, codec: Codec[Row], resume: bool) -> Session[Row]:
    """Start a session, or continue one.

    wanted: a new manifest with the request (kind, seed, objects ...); a session is continued only for the
    same request. codec: of its results. Raises `InputError` if the folder is not usable or the request
    differs, `RecordingError` if it cannot be written or another process uses it.
    """
    if (folder / MANIFEST).exists():
        if not resume:
            raise InputError(
                f"{folder} already contains a session: add --resume to continue it, or give another --out"
            )
        manifest = read_manifest(folder)
        require_same(folder, manifest, wanted)
        session = Session(folder, manifest, codec)
        if isinstance(manifest, BenchManifest) and isinstance(wanted, BenchManifest):
            remarks, limits = manifest.remarks.merge(wanted.remarks), wanted.config.limits
            if remarks != manifest.remarks or limits != manifest.config.limits:
                config = manifest.config.model_copy(update={"limits": limits})
                session.manifest = replace(manifest, remarks=remarks, config=config)
                write_json(folder / MANIFEST, json_value(session.manifest))
        return session
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: give another --out")
    # calibrations without the beginning of a manifest are a user's
    left = {path.name for path in folder.iterdir()} if folder.exists() else set()
    if not left <= ({LOCK, BEGINNING, CALIBRATIONS} if BEGINNING in left else {LOCK}):
        raise InputError(f"{folder} is not empty and contains no session: give another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created ({error.strerror}); give another --out") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written; give another --out")
    if isinstance(wanted, BenchManifest):
        _store_calibrations(folder, wanted.config.calibrations)
    write_json(folder / MANIFEST, json_value(wanted))
    return Session(folder, wanted, codec, begun_here=True)


def _store_calibrations(folder: Path, calibrations: Calibrations) -> None:
    """Copy the calibration files in use, if there are any. Raises `RecordingError`."""
    try:
        (folder / BEGINNING).touch()
        for name, content in calibrations.contents():
            (folder / CALIBRATIONS).mkdir(exist_ok=True)
            write_file(folder / CALIBRATIONS / name, content)
    except OSError as error:
        raise not_written(folder, error) from error


def newest_unfinished(kind: str, bench: str | None, folder: Path | None = None) -> Path:
    """Return the unfinished session of a kind that was started last and is not in use.

    bench: its name, None for kinds without. folder: of the sessions, by default that of new ones.
    Raises `InputError` if there is none.
    """
    folder = folder or SESSIONS
    found: list[tuple[str, Path]] = []
    elsewhere: list[tuple[str, Path, str]] = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        with suppress(InputError):  # a broken session cannot be continued
            manifest = read_manifest(path)
            if manifest.kind != kind or manifest.status != "running" or in_use(path):
                continue
            its = getattr(manifest, "bench", None)
            if bench is None or its == bench:
                found.append((manifest.started, path))
            else:
                elsewhere.append((manifest.started, path, f"on bench '{its}'"))
    if not found:
        on = "" if bench is None else f" on bench '{bench}'"
        also = f" ({max(elsewhere)[1]} is one {max(elsewhere)[2]})" if elsewhere else ""
        raise InputError(f"--resume: no unfinished {kind}{on} in {folder}/; give its folder with --out{also}")
    return max(found)[1]


def in_use(folder: Path) -> bool:
    """Whether a process holds the session's lock; a lock file alone has no effect."""
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


def require_same(folder: Path, manifest: Manifest, wanted: Manifest) -> None:
    """Raise `InputError` naming the first value in which a session and a request differ."""
    difference = first_difference(manifest, wanted)
    if difference is not None:
        raise InputError(
            f"{folder} was started with {difference}; continue with the same (options not given are those of "
            "it), or give another --out"
        )


def _lock_folder(folder: Path) -> int:
    """Lock the folder; the system releases the lock when this process ends in any way."""
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written ({error.strerror}); give another --out") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise RecordingError(f"{folder}: another rig process is writing here; wait for it to end") from error
    return handle
