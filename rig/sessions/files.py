"""Files of a session folder (contract, session folder): names, durable writing, reading."""

import json
import os
from pathlib import Path
from typing import Any

from drivers.errors import FormatError, RecordingError, SessionError
from drivers.formats import parse_json, read_bounded, write_whole

MANIFEST = "session.json"
RESULTS = {"trial": "lifts.jsonl", "record": "poses.jsonl", "replay": "replays.jsonl"}
"""Result file of each kind of session, one line per finished lift, pose or replay."""
TIMING = "timing.jsonl"
"""All measured durations, kept separate so that the other files are identical for identical seeds."""
LOG = "log.txt"
LOCK = ".lock"
"""Locked by the writing process; a file that is left behind locks nothing."""
RECORDINGS = "lifts"
UNFINISHED = ".unfinished"
"""Part of the name of a recording whose lift is in progress, or was interrupted and not resumed since."""
INTERRUPTED = ".interrupted"
"""Part of the name that such a recording gets when the session is resumed."""
MAGIC = b"\x89MCAP0\r\n"
"""First bytes of a recording."""
ROS_BEGINNINGS = (b"#ROSBAG V", b"SQLite format 3\0")
"""First bytes of bags of ROS 1, and of ROS 2 in SQLite's storage."""
CALIBRATIONS = "calibrations"
"""Folder of the copies of the calibration files in use."""
REFERENCES = "reference"
"""Folder of the fingertips' no-contact frames, in a recording."""
TRUE_MASKS = "truth/masks"
"""Folder of the true contact masks of simulated images, separate from the rig's own data."""
MOST_BYTES = 20_000_000
"""Size limit of a file that is read at once."""


def recording_file(number: int, attempt: int) -> str:
    """Return the path of an attempt's recording. number: in the session, from 1; attempt: from 0."""
    suffix = f"-attempt{attempt}" if attempt else ""
    return f"{RECORDINGS}/{number:03d}{suffix}.mcap"


def is_unfinished(recording: Path) -> bool:
    """Whether a recording has the name of an unfinished or interrupted one, which never counts as a lift."""
    return UNFINISHED in recording.stem or INTERRUPTED in recording.stem


def is_recording(path: Path) -> bool:
    """Whether a file is a recording, by its ending or its first bytes. False for a ROS bag."""
    head = first_bytes(path)
    is_mcap = head.startswith(MAGIC) or (path.suffix.lower() == ".mcap" and path.is_file())
    return is_mcap and not is_ros_file(head)


def is_ros_file(head: bytes) -> bool:
    """Whether a file is a ROS bag: ROS 1, SQLite storage, or an MCAP file whose header has a ROS profile.

    head: its first bytes, see `first_bytes`.
    """
    return head.startswith(ROS_BEGINNINGS) or (head.startswith(MAGIC) and head[21:24] == b"ros")


def first_bytes(path: Path) -> bytes:
    """Return the first 24 bytes of a file; no bytes for a folder or an unreadable file."""
    try:
        with path.open("rb") as stream:
            return stream.read(24)
    except OSError:
        return b""


def reference_file(serial: str) -> str:
    return f"{REFERENCES}/{serial}.png"


def true_mask_file(image: str) -> str:
    """Return the path of the true contact mask of a simulated image. image: its name without suffix."""
    return f"{TRUE_MASKS}/{image}.png"


def write_file(path: Path, data: bytes) -> None:
    """Write a file atomically: to a temporary file, synced, then renamed. Raises `RecordingError`."""
    if path.exists() and not path.is_file():  # a device would become a file
        raise RecordingError(f"{path}: is not a regular file; choose another path")
    try:
        write_whole(path, data)
    except OSError as error:
        raise not_written(path, error) from error


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file with sorted keys. Raises `RecordingError`."""
    write_file(path, (json.dumps(value, indent=2, sort_keys=True) + "\n").encode())


def append_line(path: Path, line: bytes) -> None:
    """Append a line and sync it. Raises `RecordingError`; no incomplete line is left behind."""
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
    """Return a file's complete lines; a last line without an end is a write in progress, or from a crash.

    A missing file has no lines. Raises `SessionError` if it cannot be read.
    """
    try:
        return path.read_bytes().split(b"\n")[:-1]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror})") from error


def state_folder() -> Path:
    """Return the folder for data that outlive a program (XDG base directory specification)."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "visuotactile-slip-rig"


def cache_folder() -> Path:
    """Return the folder for data that can be made again (XDG base directory specification)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "visuotactile-slip-rig"


def drop_torn_line(path: Path) -> None:
    """Remove an incomplete last line, left by a crash, before more lines are appended."""
    if path.exists():
        data = path.read_bytes()
        if data and not data.endswith(b"\n"):
            write_file(path, data[: data.rfind(b"\n") + 1])


def read_whole(path: Path) -> bytes:
    """Read a file of a session. Raises `SessionError`."""
    if not path.exists():
        raise SessionError(f"{path.parent}: no {path.name} here; is this a session folder?")
    try:
        return read_bounded(path, MOST_BYTES)
    except FormatError as error:
        raise SessionError(f"{error}; the session is damaged") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises `SessionError` with the problem of the file."""
    try:
        value = parse_json(read_whole(path), str(path))
    except FormatError as error:
        raise SessionError(f"{error}; the session is damaged") from error
    if not isinstance(value, dict):
        raise SessionError(f"{path}: contains no JSON object; the session is damaged")
    return value


def not_written(path: Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"{path}: cannot be written ({error.strerror or error}); finished work is safe: free space or fix "
        "the permission, then run the command again (a session: with --resume)"
    )
