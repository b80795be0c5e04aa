"""The session folder: manifest, results as they come, and resuming after anything."""

import fcntl
import json
import logging
import os
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.errors import InputError, RecordingError, SessionError
from rig.config import BenchConfig, validation_text
from rig.sessions.files import append_line, drop_torn_line, read_json, read_lines, write_file, write_json
from rig.sessions.layout import LOG, MANIFEST, TIMING

SCHEMA_VERSION = 1
DISTRIBUTION = "visuotactile-slip-rig"


class Session:
    """A folder that one process writes; every finished piece of work is on disk at once.

    Layout (contract): `session.json` manifest, `RESULTS` one line per finished piece of work,
    `timing.jsonl` everything measured in time, `log.txt`.
    """

    def __init__(self, folder: Path, manifest: dict[str, Any], results_name: str) -> None:
        self.folder = folder
        self.manifest = manifest
        self._results = folder / results_name
        self._lock = _locked(folder)
        drop_torn_line(self._results)
        drop_torn_line(folder / TIMING)
        self.rows = read_lines(self._results)
        self._log = logging.FileHandler(folder / LOG)
        self._log.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        logger = logging.getLogger("rig")
        logger.setLevel(logging.INFO)
        logger.addHandler(self._log)

    @property
    def complete(self) -> bool:
        """Whether the session has reached its target."""
        return self.manifest["status"] == "complete"

    def add(self, row: dict[str, Any], timing: dict[str, Any]) -> None:
        """Keep the result of one piece of work. Raises `RecordingError`."""
        append_line(self._results, row)
        append_line(self.folder / TIMING, timing)
        self.rows.append(row)

    def write(self, name: str, data: bytes) -> None:
        """Keep a file in the session. Raises `RecordingError`."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)

    def finish(self, order: tuple[str, ...]) -> None:
        """Put the results in order (they may have come side by side) and mark the target reached."""
        self.rows.sort(key=lambda row: tuple(row[key] for key in order))
        lines = "".join(json.dumps(row, sort_keys=True) + "\n" for row in self.rows)
        write_file(self._results, lines.encode())
        self.manifest = {**self.manifest, "status": "complete", "completed": _now()}
        write_json(self.folder / MANIFEST, self.manifest)

    def close(self) -> None:
        """Let another process use the folder. Safe to call twice."""
        logging.getLogger("rig").removeHandler(self._log)
        self._log.close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def default_folder(kind: str, object_id: str | None = None) -> Path:
    """Return `sessions/<date>_<object>_<kind>`, sortable by name."""
    stamp = datetime.now(UTC).astimezone().strftime("%Y-%m-%dT%H%M%S")
    middle = f"_obj{object_id}" if object_id else ""
    return Path("sessions") / f"{stamp}{middle}_{kind}"


def session_request(kind: str, bench: BenchConfig, seed: int, **more: Any) -> dict[str, Any]:
    """Return what identifies a session in its manifest, and must be the same to continue it."""
    return {
        "kind": kind,
        "bench": bench.name,
        "simulated": bench.simulated,
        "seed": seed,
        "serials": [*(t.serial for t in bench.tactile), bench.camera.serial],
        "signs": {t.serial: t.sign for t in bench.tactile},
        "calibration": {name: file.model_dump() for name, file in bench.calibrations.files.items()},
        "config": bench.model_dump(mode="json"),
        **more,
    }


def open_session(folder: Path, request: dict[str, Any], results_name: str, resume: bool) -> Session:
    """Start a session, or continue one.

    request: what was asked for (kind, seed, objects ...); a session is continued only for the
    same request. Raises `InputError` when the folder is taken or the request differs,
    `RecordingError` when it cannot be written or another process uses it.
    """
    manifest_path = folder / MANIFEST
    if manifest_path.exists():
        if not resume:
            raise InputError(
                f"{folder} already holds a session: add --resume to continue it, or give another --out"
            )
        manifest = read_manifest(folder)
        _require_same(folder, manifest, request)
        return Session(folder, manifest, results_name)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: give another --out")
    if folder.exists() and any(folder.iterdir()) and not _left_by_a_crash(folder):
        raise InputError(f"{folder} is not empty and holds no session: give another --out")
    _make_folder(folder)
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "tool_version": version(DISTRIBUTION),
        "status": "running",
        "started": _now(),
        **request,
    }
    write_json(manifest_path, manifest)
    return Session(folder, manifest, results_name)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read and check a session's manifest. Raises `SessionError`."""
    manifest = read_json(folder / MANIFEST)
    found = manifest.get("schema_version")
    if found != SCHEMA_VERSION:
        raise SessionError(
            f"{folder / MANIFEST}: schema version {found!r}, this version reads {SCHEMA_VERSION}; "
            "use the version of the rig that wrote it"
        )
    return manifest


def manifest_bench(folder: Path, manifest: dict[str, Any]) -> BenchConfig:
    """Return the bench a session was made on, calibrations included. Raises `SessionError`."""
    try:
        return BenchConfig.model_validate(manifest["config"])
    except KeyError as error:
        raise SessionError(f"{folder / MANIFEST}: {error} is missing; the session is damaged") from error
    except ValidationError as error:
        raise SessionError(f"{folder / MANIFEST}: config: {validation_text(error)}") from error


def _require_same(folder: Path, manifest: dict[str, Any], request: dict[str, Any]) -> None:
    for key, wanted in request.items():
        if manifest.get(key) != wanted:
            raise InputError(
                f"{folder} was started with another {key}; continue with the same options, "
                "or give another --out"
            )


def _left_by_a_crash(folder: Path) -> bool:
    """Whether only the traces of a start that was killed before its manifest are there."""
    return all(path.name in (".lock", MANIFEST + ".part") for path in folder.iterdir())


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created ({error.strerror}); give another --out") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written; give another --out")


def _locked(folder: Path) -> int:
    """Take the folder's lock; the system lets go of it when this process ends, however it ends."""
    try:
        handle = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written ({error.strerror}); give another --out") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise RecordingError(f"{folder}: another rig process is writing here; wait for it to end") from error
    return handle


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
