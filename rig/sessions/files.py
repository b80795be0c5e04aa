"""Writing results so that they are on disk when the call returns, and reading them back."""

import json
import os
from pathlib import Path
from typing import Any

from drivers.errors import FormatError, RecordingError, SessionError
from drivers.formats import parse_json, read_bounded, write_whole

MOST_BYTES = 20_000_000
"""Of a file that is read whole."""


def write_file(path: Path, data: bytes) -> None:
    """Write a whole file aside, sync it, then put it in place. Raises `RecordingError`."""
    if path.exists() and not path.is_file():  # a device would become a file
        raise RecordingError(f"{path}: is no file; choose another place")
    try:
        write_whole(path, data)
    except OSError as error:
        raise not_written(path, error) from error


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file with sorted keys. Raises `RecordingError`."""
    write_file(path, (json.dumps(value, indent=2, sort_keys=True) + "\n").encode())


def append_line(path: Path, line: bytes) -> None:
    """Append a line and sync it. Raises `RecordingError`; no torn line is left behind."""
    try:
        with path.open("ab") as stream:
            end = stream.tell()
            try:
                stream.write(line)
                stream.flush()
                os.fsync(stream.fileno())
            except OSError:
                os.truncate(path, end)
                raise
    except OSError as error:
        raise not_written(path, error) from error


def complete_lines(path: Path) -> list[bytes]:
    """Return a file's lines, without one at the end that has none: a write in progress, or a crash.

    A file that is not there has no lines. Raises `SessionError` when it cannot be read.
    """
    try:
        return path.read_bytes().split(b"\n")[:-1]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror})") from error


def state_folder() -> Path:
    """Where programs keep what outlives them (XDG base directory specification)."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "visuotactile-slip-rig"


def drop_torn_line(path: Path) -> None:
    """Cut a last line that a crash left without its end, before more is appended."""
    if path.exists():
        data = path.read_bytes()
        if data and not data.endswith(b"\n"):
            write_file(path, data[: data.rfind(b"\n") + 1])


def read_whole(path: Path) -> bytes:
    """Read one of a session's whole files. Raises `SessionError`."""
    if not path.exists():
        raise SessionError(f"{path.parent}: no {path.name} here; is this a session folder?")
    try:
        return read_bounded(path, MOST_BYTES)
    except FormatError as error:
        raise SessionError(f"{error}; the session is damaged") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises `SessionError` saying what is wrong with the file."""
    try:
        value = parse_json(read_whole(path), str(path))
    except FormatError as error:
        raise SessionError(f"{error}; the session is damaged") from error
    if not isinstance(value, dict):
        raise SessionError(f"{path}: holds no JSON object; the session is damaged")
    return value


def not_written(path: Path, error: OSError) -> RecordingError:
    """Return the error of a file that cannot be written."""
    return RecordingError(
        f"{path}: cannot be written ({error.strerror or error}); finished work is safe: free space or fix "
        "the permission, then run the command again, a session with --resume"
    )
