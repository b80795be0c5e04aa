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
    """Whether a file is a recording, by its ending or by its first bytes."""
    if path.suffix.lower() == ".mcap":
        return path.is_file()
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:  # a folder, or a file whose reader says what is wrong with it
        return False


def reference_file(serial: str) -> str:
    """Return where a fingertip's frame without contact is kept."""
    return f"{REFERENCES}/{serial}.png"


def true_mask_file(image: str) -> str:
    """Return where the true contact of a simulated image is kept. image: its name without ending."""
    return f"{TRUE_MASKS}/{image}.png"
