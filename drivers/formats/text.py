"""Files read up to a size or written whole, and bytes of unknown origin shown in an error message."""

import os
import re
from contextlib import suppress
from pathlib import Path

from drivers.errors import FormatError

_LONGEST_REASON, _LONGEST_VALUE = 160, 60


_LOGIN = re.compile(r"(://[^/@\s:]*):[^/\s]*@")
_SECRET = re.compile(r"([?&][^=&\s]*(?:pass|pwd|token|secret|auth|key)[^=&\s]*=)[^&\s'\"]+", re.IGNORECASE)


def without_passwords(text: str) -> str:
    """Return a text with *** for the passwords of web addresses in it."""
    return _SECRET.sub(r"\1***", _LOGIN.sub(r"\1:***@", text))


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most so many bytes. Raises `FormatError`, also where it cannot be read."""
    try:
        with path.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise FormatError(f"{path}: cannot be read ({reason(error)})") from error
    if len(data) > most_bytes:
        raise FormatError(f"{path}: is larger than {most_bytes / 1e6:g} MB, the most that is read")
    return data


def read_text(path: Path, most_bytes: int) -> str:
    """Read UTF-8, with or without a byte order mark. Raises `FormatError`."""
    try:
        return read_bounded(path, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: cannot be read as text ({reason(error)})") from error


def shown(value: object) -> str:
    """Return a value that somebody else wrote, shortened, as an error shows it."""
    text = without_passwords(repr(value))
    return text if len(text) <= _LONGEST_VALUE else text[:_LONGEST_VALUE] + "..."


def reason(error: BaseException) -> str:
    """Return why something failed, in one line that can be printed, without what it was made of."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    text = text.partition("; use sys.")[0]  # advice to programmers, on numbers of very many digits
    line = without_passwords(" ".join(text.encode("utf-8", "backslashreplace").decode().split()))
    return line if len(line) <= _LONGEST_REASON else line[:_LONGEST_REASON] + " ..."


def write_whole(path: Path, data: bytes) -> None:
    """Write a file aside, sync it, then put it in place; nothing is left behind. Raises `OSError`."""
    aside = path.with_name(path.name + ".part")
    try:
        with aside.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(path)
    except OSError:
        with suppress(OSError):
            aside.unlink()
        raise
