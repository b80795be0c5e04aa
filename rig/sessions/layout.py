"""What a session folder holds (contract, session folder): names of its files and folders, said once."""

from pathlib import Path

MANIFEST = "session.json"
RESULTS = {"trial": "lifts.jsonl", "record": "poses.jsonl", "replay": "replays.jsonl"}
"""Where each kind of session keeps its finished work, a line each."""
TIMING = "timing.jsonl"
"""Everything that was measured in time, so that all else is identical for identical seeds."""
LOG = "log.txt"
LOCK = ".lock"
"""Held by the process that writes; left behind it holds nothing."""
RECORDINGS = "lifts"
UNFINISHED = ".unfinished"
"""In the name of a recording whose lift is under way or was interrupted."""
MAGIC = b"\x89MCAP0\r\n"
"""First bytes of a recording."""
ROS_BEGINNINGS = (b"#ROSBAG V", b"SQLite format 3\0")
"""First bytes of bags of ROS 1, and of ROS 2 in SQLite's storage."""
REFERENCES = "reference"
"""Each fingertip's frame without contact, in a recording."""
TRUE_MASKS = "truth/masks"
"""Where the true contacts of simulated images are kept, apart from what the rig sees."""


def recording_file(number: int, attempt: int) -> str:
    """Return where an attempt at a lift is recorded. number: in the session, from 1; attempt: from 0."""
    suffix = f"-attempt{attempt}" if attempt else ""
    return f"{RECORDINGS}/{number:03d}{suffix}.mcap"


def unfinished_name(stem: str, number: int) -> str:
    """Return the file name of an unfinished recording. stem: of its final name. number: from 1."""
    return f"{stem}{UNFINISHED}{'' if number == 1 else f'-{number}'}.mcap"


def is_unfinished(recording: Path) -> bool:
    """Whether a recording has the name of an unfinished one."""
    return UNFINISHED in recording.stem


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
    """Return where a fingertip's frame without contact is kept."""
    return f"{REFERENCES}/{serial}.png"


def true_mask_file(image: str) -> str:
    """Return where the true contact of a simulated image is kept. image: its name without ending."""
    return f"{TRUE_MASKS}/{image}.png"
